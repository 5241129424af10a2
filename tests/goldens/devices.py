"""What drivers say to their devices, and what panels show.

The only file of the goldens that reaches into the program and its test rigs: where those move, this
is what moves with them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

import drivers.ptp.eos
from drivers.ptp.codes import Operation
from drivers.virtual_camera import FaultScript, ScriptedFault, VirtualUsb, make_bench_backend
from pdcd.bench.clock import RealClock
from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config, PanelConfig
from pdcd.figures.catalog import FIGURES, choose_figures
from pdcd.figures.make import make_paper_figures, open_processes
from pdcd.panels.draw import draw, draw_planes
from pdcd.panels.frames import Frames
from pdcd.panels.placing import Placing
from tests import whole_rig, x11_rig, xserver
from tests.fake_serial import FakeLine, fake_line
from tests.figures_rig import TINY_MODE
from tests.goldens.case import UnavailableError
from tests.goldens.masks import RAW_TIME
from tests.panel_pixels import random_frames

SHORT_B = 1024
"""Longer transfers are kept by their digest."""

FAULTS: Mapping[str, FaultScript | None] = {
    "none": None,
    "late-file": FaultScript(file="late", late_s=25.0),
    "truncated-file": FaultScript(file="truncated"),
    "no-file": FaultScript(file="none"),
    "deaf": FaultScript(wire=(ScriptedFault("deaf", Operation.EOS_BULB_END, 2),)),
    "mute": FaultScript(wire=(ScriptedFault("mute", Operation.EOS_BULB_START),)),
    "unplugged": FaultScript(wire=(ScriptedFault("unplug", Operation.EOS_BULB_END, 2),)),
    "corrupt": FaultScript(wire=(ScriptedFault("corrupt", Operation.GET_PARTIAL_OBJECT),)),
}
"""What goes wrong with the virtual camera, by name."""

PLACES: Mapping[str, Mapping[str, Placing]] = {
    "upright": {},
    "bent": {
        "projector": Placing(
            flip="horizontal", turn_deg=-5.0, scale=1.2, offset_px=(2.5, -3.0), radial=(0.06, -0.02)
        ),
        "mask": Placing(
            turn_deg=184.0,
            scale=1.3,
            offset_px=(1.3, 0.7),
            radial=(-0.03, 0.0),
            tangential=(0.004, -0.003),
        ),
    },
}
"""Where both panels lie."""


class _NoTicks:
    """Stands in for the thread that keeps a camera awake, which goes by real time."""

    def __init__(self, *_: object) -> None:
        pass

    def stop(self) -> None:
        """Nothing to end."""


@contextmanager
def usb_transcript() -> Iterator[list[list[Any]]]:
    """Every transfer over the virtual USB, as [what, where, bytes]; photos without their time."""
    told: list[list[Any]] = []
    plain = {name: getattr(VirtualUsb, name) for name in ("bulk_write", "bulk_read")}
    control = VirtualUsb.ctrl_transfer

    def bulk(name: str) -> Callable[..., int]:
        def transfer(usb: VirtualUsb, handle: Any, ep: int, intf: int, data: Any, wait: int) -> int:
            try:
                count = int(plain[name](usb, handle, ep, intf, data, wait))
            except Exception as err:
                told.append([name, ep, f"{type(err).__name__}: {err}"])
                raise
            told.append([name, ep, _bytes_in_words(memoryview(data).cast("B")[:count].tobytes())])
            return count

        return transfer

    def class_request(usb: VirtualUsb, handle: Any, kind: int, request: int, *rest: Any) -> int:
        count = int(control(usb, handle, kind, request, *rest))
        told.append(["control", [kind, request, rest[0]], _bytes_in_words(bytes(rest[2]))])
        return count

    with ExitStack() as patches:
        for name in plain:
            patches.enter_context(mock.patch.object(VirtualUsb, name, bulk(name)))
        patches.enter_context(mock.patch.object(VirtualUsb, "ctrl_transfer", class_request))
        patches.enter_context(mock.patch.object(drivers.ptp.eos, "KeepAlive", _NoTicks))
        yield told


def _bytes_in_words(data: bytes) -> str:
    data = RAW_TIME.sub(b"0000:00:00 00:00:00", data)
    if len(data) <= SHORT_B:
        return data.hex(" ")
    return f"{data[:16].hex(' ')} ... {len(data)} bytes {hashlib.sha256(data).hexdigest()}"


def play_faults(bench: Any, fault: str) -> None:
    """Put a camera with that fault on the virtual USB of `pdcd.local(...)`."""
    context = bench._engine._rig._context
    backend = make_bench_backend(context, script=FAULTS[fault])
    drivers.ptp.eos.EosCamera.of(context).session._backend = backend


@contextmanager
def serial_line(answers: Mapping[str, str] | None = None) -> Iterator[FakeLine]:
    """A port `line://golden`. answers : what comes back, by what is sent, both in hexadecimal."""
    told = {bytes.fromhex(sent): bytes.fromhex(back) for sent, back in (answers or {}).items()}
    with fake_line("golden", RealClock()) as line:
        line.answer = lambda sent: told.get(bytes(sent), b"")
        yield line


def keep_time(line: FakeLine, bench: Any, *, flash: bool = False) -> None:
    """Let a line go by the clock of `pdcd.local(...)`. flash : its CTS follows RTS, after a lag."""
    line.clock = bench._engine._rig.clock
    if flash:
        line.cts = lambda: _last_level(line, "rts", 60_000_000)


def _last_level(line: FakeLine, name: str, lag_ns: int) -> bool:
    now_ns = line.clock.now_ns()
    past = [edge.level for edge in line.edges if edge.line == name and edge.t_ns + lag_ns <= now_ns]
    return bool(past) and past[-1]


def plug_cable(line: FakeLine, bench: Any) -> None:
    """The cable of the line into the jack of the virtual body."""
    keep_time(line, bench)
    whole_rig.plug(line, whole_rig.usb_of(bench._engine))


def edges_of(line: FakeLine) -> list[list[Any]]:
    """What a line was set to, and what was sent, in order."""
    edges: list[list[Any]] = [[edge.t_ns, edge.line, edge.level] for edge in line.edges]
    return [*edges, *(["sent", sent.hex(" ")] for sent in line.received), ["opened", line.opened]]


def drawn_panels(
    window: str, grid: tuple[int, int], places: str, *, grey: bool = False
) -> dict[str, np.ndarray]:
    """What `draw` says that both panels show, of random frames."""
    views = _views(xserver.QUARTER, places)
    frames = random_frames(grid, window, 6, grey=grey)
    found = {}
    for panel, view in zip(("projector", "mask"), views, strict=True):
        for row in range(len(frames)):
            found[f"{panel}-{row}"] = draw(frames, view, row)
    if not grey:
        many = random_frames(grid, window, 24)
        for panel, view in zip(("projector", "mask"), views, strict=True):
            found[f"{panel}-planes"] = draw_planes(many, view, range(24), "GRB")
    return found


def _views(sizes: Sequence[tuple[int, int]], places: str) -> tuple[Any, Any]:
    tables = _panel_tables(sizes, places)
    views = panels_of(Config(**tables))
    return views.projector, views.mask


def _panel_tables(sizes: Sequence[tuple[int, int]], places: str) -> dict[str, Any]:
    return {
        role: PanelConfig(size_px=size, place=PLACES[places].get(role, Placing()))
        for role, size in zip(("projector", "mask"), sizes, strict=True)
    }


@contextmanager
def x_server() -> Iterator[xserver.XServer]:
    """An X server with two small panels. Raises UnavailableError where none can run."""
    with ExitStack() as stack:
        try:
            server = stack.enter_context(xserver.run(*xserver.QUARTER))
        except pytest.skip.Exception as err:
            raise UnavailableError(str(err)) from None
        yield server


def shown_panels(
    server: xserver.XServer,
    folder: Path,
    wanted: Sequence[tuple[str, tuple[int, int], bool]],
    places: str,
    layout: str,
) -> dict[str, np.ndarray]:
    """The pixels of both panels on the X screen, of random frames. wanted : window, grid, grey."""
    sizes = server.projector_px, server.mask_px
    tables = _panel_tables(sizes, places)
    config = x11_rig.config(folder, server, more={"layout": layout}, **tables)
    display = x11_rig.display(config)
    display.connect()
    found: dict[str, np.ndarray] = {}
    try:
        for window, grid, grey in wanted:
            frames = random_frames(grid, window, 6, grey=grey)
            for row in range(len(frames)):
                display.show(_only(frames, row))
                projector, mask, rest = x11_rig.panels(server)
                name = f"{window}-{grid[0]}x{grid[1]}-{row}".replace("/", "-")
                found |= {f"{name}-projector": projector, f"{name}-mask": mask}
                found[f"{name}-rest"] = np.array(rest)
        display.black()
        found["black"] = x11_rig.root_pixels(server)
    finally:
        display.disconnect()
    return found


def _only(frames: Frames, row: int) -> Frames:
    """One row of the frames, to be held."""
    names = ("primal_index", "dual_index", "shift", "code", "guard")
    return replace(frames, **{name: getattr(frames, name)[row : row + 1] for name in names})


def make_figures(folder: Path, numbers: Sequence[str]) -> dict[str, Any]:
    """Figures in the smallest setting that there is, into a folder; what could not be made."""
    with open_processes(1) as pool:
        outcome = make_paper_figures(
            choose_figures(list(numbers)), folder, TINY_MODE, pool, plots=True
        )
    return {"made": [made["number"] for made in outcome.made], "failed": outcome.failed}


def figure_numbers() -> list[str]:
    """All figures."""
    return list(FIGURES)
