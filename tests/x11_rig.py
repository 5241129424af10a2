"""Rigs whose panels are windows of a test's X server, and what the server really shows."""

from __future__ import annotations

import os
from contextlib import suppress
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from Xlib import X
from Xlib.display import Display

from drivers.x11 import X11Display
from pdcd.bench.tables import Config, DisplayConfig, PanelConfig, RigConfig
from pdcd.capture.rig import Rig
from pdcd.frames.frames import BLACK, WHITE, Frames
from pdcd.frames.patterns import levels_of
from tests import bench_rig
from tests.xserver import XServer

Pixels = NDArray[np.uint8]

BUSY = 0.75
"""Load for each core from which lost refreshes are the machine's own."""


def hurry(server: XServer) -> None:
    """Let the server keep time beside whatever else this machine does, where that is permitted.

    A screen's vblank comes from its hardware; without one it is a timer of the server's.
    """
    with suppress(PermissionError):
        os.sched_setscheduler(server.pid, os.SCHED_FIFO, os.sched_param(10))


def busy() -> bool:
    """Whether refreshes may well be lost to other work of this machine."""
    return os.getloadavg()[0] > BUSY * (os.cpu_count() or 1)


def options(server: XServer, **more: Any) -> dict[str, Any]:
    """[display.options] for a server of `tests.xserver`."""
    found = {
        "projector": server.projector,
        "mask": server.mask,
        "display": server.display,
        "allow_software": True,
        "time_source": "present-msc",  # what "auto" finds here, after half a second
        "hang_s": 20.0,  # a busy machine may keep a display process waiting for seconds
        **more,
    }
    if server.kind == "xvfb":
        found.setdefault("positions_px", [[0, 0], [server.projector_px[0], 0]])
    return found


def config(
    folder: Path,
    server: XServer,
    *,
    grid: tuple[int, int] = bench_rig.GRID,
    more: dict[str, Any] | None = None,
    **tables: Any,
) -> Config:
    """The mock camera and shutter before real windows."""
    given = {
        "rig": RigConfig(clock="real", on_miss="flag"),
        "projector": PanelConfig(size_px=server.projector_px),
        "mask": PanelConfig(size_px=server.mask_px),
        "display": DisplayConfig(driver="x11", options=options(server, **(more or {}))),
        **tables,
    }
    return bench_rig.config(folder, grid=grid, **given)


def display(config: Config) -> X11Display:
    found = Rig(config).display
    assert isinstance(found, X11Display)
    return found


def root_pixels(server: XServer) -> Pixels:
    """What the X screen shows, (H, W, 3) uint8, by python-xlib."""
    display = Display(server.display)
    try:
        root = display.screen().root
        size = root.get_geometry()
        width, height = size.width, size.height
        image = root.get_image(0, 0, width, height, X.ZPixmap, 0xFFFFFFFF)
    finally:
        display.close()
    # 4 bytes a pixel, lowest first: blue, green, red, unused.
    return np.frombuffer(image.data, dtype=np.uint8).reshape(height, width, 4)[..., 2::-1]


def panels(server: XServer) -> tuple[Pixels, Pixels, int]:
    """What projector and mask show, and the brightest pixel of the rest of the screen."""
    whole = root_pixels(server).copy()
    (pw, ph), (mw, mh) = server.projector_px, server.mask_px
    projector, mask = whole[:ph, :pw].copy(), whole[:mh, pw : pw + mw].copy()
    whole[:ph, :pw] = 0
    whole[:mh, pw : pw + mw] = 0
    return projector, mask, int(whole.max())


def planned(frames: Frames, row: int, size_px: tuple[int, int], *, mask: bool) -> Pixels:
    """What one row is to put on a panel, (h, w) uint8: pixel by pixel, in exact fractions."""
    width, height = size_px
    index = int((frames.dual_index if mask else frames.primal_index)[row])
    if index in (BLACK, WHITE):
        return np.full((height, width), 255 if index == WHITE else 0, dtype=np.uint8)
    patterns = frames.dual_patterns if mask else frames.primal_patterns
    lattice_rows, lattice_cols = frames.lattice
    levels = levels_of(patterns, index, lattice_rows * lattice_cols)
    levels = levels.reshape(frames.lattice)
    shift, quarter = int(frames.shift[row]), frames.window == "quarter"
    ys, y_open = _axis(height, frames.grid[0], shift >> 1, half=mask and quarter)
    xs, x_open = _axis(width, frames.grid[1], shift & 1, half=mask and quarter)
    image = np.rint(levels[np.ix_(ys, xs)] * 255.0)
    return np.asarray(image * np.outer(y_open, x_open), dtype=np.uint8)


@cache
def _axis(size_px: int, cells: int, bit: int, *, half: bool) -> tuple[list[int], list[bool]]:
    """Cell of every pixel along an axis, and whether the pixel is inside the cell's window."""
    places = [Fraction(x * cells, size_px) + Fraction(bit, 2) for x in range(size_px)]
    inside = [not half or Fraction(1, 4) <= p % 1 < Fraction(3, 4) for p in places]
    return [int(p) for p in places], inside
