"""A whole bench in one process: the daemon, a serial cable release, an EOS 450D on the USB.

The line's edges press and let go of the body's cable release; codes, shutter and photos go through
the drivers that a real bench uses. The scene behind the body's lens is that of the mock bench.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.virtual_camera import CameraBody, VirtualUsb
from pdcd.bench.clock import RealClock
from pdcd.bench.tables import CameraConfig, Config, TriggerConfig
from pdcd.capture.engine import Engine
from pdcd.client import Client
from pdcd.errors import PdcdError
from pdcd.server.daemon import serve_daemon
from tests.fake_serial import Edge, FakeLine, fake_line
from tests.real_daemon import connect

PATIENCE_S = 30.0
CABLE = TriggerConfig(driver="serial", options={"port": "line://cable", "feedback": "cts"})
BLIND = TriggerConfig(driver="serial", options={"port": "line://cable"})
BODY = CameraConfig(driver="ptp", noise="none", f_number=8.0, options={"usb": "virtual"})


@dataclass
class WholeRig:
    """What a test sees of the bench: the daemon's socket, its engine, cable and body."""

    socket: Path
    engine: Engine
    line: FakeLine
    usb: VirtualUsb

    @property
    def body(self) -> CameraBody:
        return self.usb.body

    def client(self) -> Client:
        return Client(self.socket)


def plug(line: FakeLine, usb: VirtualUsb) -> None:
    """Put the cable between the line and the body's jack, and its flash contact on CTS."""

    def pressed(edge: Edge) -> None:
        if edge.line == "rts":
            with usb._lock:  # the body is not for two threads at once
                (usb.body.press if edge.level else usb.body.release)()

    def contact() -> bool:
        with usb._lock:
            open_ns = usb.body.shutter._open_ns  # when the blades will be, a lag after the order
            return open_ns is not None and line.clock.now_ns() >= open_ns

    line.on_edge, line.cts = pressed, contact


def usb_of(engine: Engine) -> VirtualUsb:
    """The bus that the camera of an engine is on."""
    usb = engine._rig._context.shared.usb_backend
    assert isinstance(usb, VirtualUsb)
    return usb


@contextmanager
def served(config: Config) -> Iterator[WholeRig]:
    """The daemon of that configuration in a thread, ready for clients; ended on leaving."""
    socket = Path(str(config.server.state_dir)).parent / "s"
    made: list[Engine] = []
    stop = asyncio.Event()
    loops: list[asyncio.AbstractEventLoop] = []
    failed: list[PdcdError] = []
    with fake_line("cable", RealClock()) as line:  # that clock until the rig has its own

        def factory(config: Config) -> Engine:
            engine = Engine.from_config(config)
            line.clock = engine._rig.clock
            plug(line, usb_of(engine))
            made.append(engine)
            return engine

        def run() -> None:
            async def body() -> None:
                loops.append(asyncio.get_running_loop())
                await serve_daemon(config, socket=socket, engine_factory=factory, stop=stop)

            try:
                asyncio.run(body())
            except PdcdError as err:
                failed.append(err)

        thread = threading.Thread(target=run)
        thread.start()
        try:
            with connect(socket, thread.is_alive, lambda: f"it did not start: {failed}") as client:
                assert client.status().state == "idle"  # the rig has started
            (engine,) = made
            yield WholeRig(socket, engine, line, usb_of(engine))
        finally:
            if loops and not loops[0].is_closed():
                loops[0].call_soon_threadsafe(stop.set)
            thread.join(PATIENCE_S)
        assert not thread.is_alive() and not failed


def tables(**more: Any) -> dict[str, Any]:
    """[camera] and [trigger] of this bench."""
    return {"camera": BODY, "trigger": CABLE, **more}
