"""Benches of a soak: what a daemon runs on, and what of it can be seen from outside."""

from __future__ import annotations

import fcntl
import os
import select
import termios
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.virtual_camera import BULB_BODY, CameraExposure, make_chart_film
from pdcd.bench import config as settings
from pdcd.bench.clock import RealClock
from pdcd.bench.tables import CameraConfig, RigConfig, ServerConfig, TriggerConfig
from pdcd.presenter.xgrab import RootGrabber
from tests import bench_rig, remote_usb, x11_rig
from tests.hostile.camera import HostileBody, HostileUsb
from tests.hostile.card import Card
from tests.soak import disk
from tests.soak.daemon import USB
from tests.soak.wanted import GRID
from tests.xserver import QUARTER, run

STATE_MIB = 64
"""Size of the file system that state folders lie on, where one may be mounted."""


@dataclass
class Bench:
    """One bench.

    lit : whether any pixel of the panels is lit; None where nobody but the daemon can tell.
    is_open : the same of the shutter.
    freed : makes a port ready for the next daemon, after one that was killed.
    mounted : whether the state folder is a small file system of its own.
    live : whether its photos take no seconds each, so that there is a live picture of them.
    provoke : has what photos come from mean harm from now on, or be honest again; None where it
        is the program's own mock.
    """

    name: str
    folder: Path
    config: Path
    lit: Callable[[], bool] | None = None
    is_open: Callable[[], bool] | None = None
    freed: Callable[[], None] = lambda: None
    mounted: bool = False
    live: bool = False
    provoke: Callable[[bool], None] | None = None

    @property
    def state(self) -> Path:
        """The state folder."""
        return self.folder / "state"


def _written(folder: Path, **tables: Any) -> Path:
    """A configuration file for a bench with its state below a folder."""
    server = ServerConfig(state_dir=str(folder / "state"), arrays=str(folder / "arrays"))
    given = {"server": server, **tables}
    path = folder / "pdcd.toml"
    path.write_text(settings.format_config(bench_rig.config(folder, grid=GRID, **given)))
    return path


@contextmanager
def _small_disk(folder: Path) -> Iterator[bool]:
    """The state folder on a file system of its own, where this user may mount one."""
    state = folder / "state"
    state.mkdir()
    mounted = disk.mount(state, STATE_MIB)
    try:
        yield mounted
    finally:
        if mounted:
            disk.unmount(state)


@contextmanager
def mocks(folder: Path) -> Iterator[Bench]:
    """All devices mock, on a clock that does not wait: for many captures."""
    with _small_disk(folder) as mounted:
        yield Bench("mock bench", folder, _written(folder), mounted=mounted, live=True)


class Box:
    """A shutter on a terminal that opens on "1" and closes on "0"."""

    def __init__(self) -> None:
        self._near, self._far = os.openpty()
        self.port = os.ttyname(self._far)
        self.open = False
        self.on_close: Callable[[], object] = lambda: None
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        with suppress(OSError, ValueError):  # it was put away
            while select.select([self._near], [], [])[0]:
                was_open, self.open = self.open, os.read(self._near, 64)[-1:] == b"1"
                if was_open and not self.open:
                    self.on_close()

    def freed(self) -> None:
        """Let the port be opened anew, as its last close does: this end holds it open too."""
        fcntl.ioctl(self._far, termios.TIOCNXCL)

    @property
    def trigger(self) -> TriggerConfig:
        """[trigger] for it."""
        options = {"port": self.port, "release": "command", "open_hex": "31", "close_hex": "30"}
        return TriggerConfig(driver="serial", lag_s=0.001, jitter_s=0.0, options=options)


@contextmanager
def windows(folder: Path) -> Iterator[Bench]:
    """Real windows of an X server, a shutter on a terminal, the mock camera; in real time."""
    with run(*QUARTER) as server, ExitStack() as held:
        box = Box()
        grabber = RootGrabber(server.display)
        held.callback(grabber.close)
        shown = x11_rig.config(folder, server, more={"hang_s": 5.0})
        tables = {name: getattr(shown, name) for name in ("projector", "mask", "display")}
        config = _written(
            folder,
            rig=RigConfig(clock="real", on_miss="flag", settle_s=0.03),
            camera=CameraConfig(noise="none", f_number=8.0),
            trigger=box.trigger,
            **tables,
        )

        def lit() -> bool:
            return bool(grabber.grab().any())

        yield Bench(
            "windows and a serial shutter",
            folder,
            config,
            lit,
            lambda: box.open,
            box.freed,
            live=True,
        )


@contextmanager
def body(folder: Path) -> Iterator[Bench]:
    """An EOS body on a USB that this process lends, its bulb by USB too; in real time."""
    usb = HostileUsb(HostileBody(RealClock(), make_chart_film((480, 720)), BULB_BODY))
    listener = remote_usb.serve(usb, folder / USB)
    config = _written(
        folder,
        rig=RigConfig(clock="real", on_miss="flag", settle_s=0.03),
        camera=CameraConfig(driver="ptp", noise="none", f_number=8.0, fetch_timeout_s=20.0),
        trigger=TriggerConfig(driver="ptp"),
    )
    try:
        yield Bench(
            "camera on USB",
            folder,
            config,
            None,
            lambda: usb.body.shutter.is_open,
            provoke=usb.provoke,
        )
    finally:
        usb.provoke(False)
        listener.close()


@contextmanager
def card(folder: Path) -> Iterator[Bench]:
    """A folder that another program saves photos to, a shutter on a terminal; in real time."""
    box = Box()
    photo = make_chart_film((480, 720)).make_raw(CameraExposure(0, 10**9, 100, 8.0))
    watched = Card(folder / "card", folder / "private.dng", photo)
    box.on_close = watched.photograph
    camera = CameraConfig(
        driver="folder",
        f_number=8.0,
        fetch_timeout_s=5.0,
        options={"folder": str(watched.folder), "poll_s": 0.05},
    )
    real = RigConfig(clock="real", on_miss="flag", settle_s=0.03)
    config = _written(folder, rig=real, camera=camera, trigger=box.trigger)
    try:
        yield Bench(
            "watched folder", folder, config, None, lambda: box.open, box.freed,
            provoke=watched.provoke,
        )  # fmt: skip
    finally:
        watched.provoke(False)


BENCHES = {"mocks": mocks, "windows": windows, "body": body, "card": card}
