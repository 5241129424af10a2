"""Rigs whose panels are windows of a test's X server, and what the server really shows."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from Xlib import X
from Xlib.display import Display

from drivers.x11 import X11Display
from pdcd.bench.tables import Config, DisplayConfig, PanelConfig, RigConfig
from pdcd.capture.rig import Rig
from pdcd.panels.pixels import PanelBox
from tests import bench_rig
from tests.xserver import XServer

Pixels = NDArray[np.uint8]

BLACK_WITHIN_S = 0.1
"""How long panels may stay lit when what draws on them is killed."""
WATCHED_S = 1.0
"""How long the screen is looked at after a kill: light must not come back either."""
TRIES = 3
"""A machine that does other work too may hold back the server that removes the windows."""
BUSY = 0.75
"""Load for each core from which lost refreshes are the machine's own."""


def busy() -> bool:
    """Whether refreshes may well be lost to other work of this machine."""
    return os.getloadavg()[0] > BUSY * (os.cpu_count() or 1)


def assert_dark_in_time(lit_s: list[float]) -> None:
    """Fail where the quickest of a few kills left light too long; skip where the machine did."""
    if min(lit_s) < BLACK_WITHIN_S:
        return
    told = ", ".join(f"{1e3 * t:.0f} ms" for t in lit_s)
    if busy() and min(lit_s) < WATCHED_S / 2:
        load = os.getloadavg()[0]
        pytest.skip(f"THE MACHINE IS TOO BUSY (load {load:.1f}): panels were lit for {told}")
    pytest.fail(f"panels were lit for {told} after the kill")


def again(lit_s: list[float]) -> bool:
    """Whether one more kill is to be tried."""
    return len(lit_s) < TRIES and min(lit_s, default=1.0) >= BLACK_WITHIN_S


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


def panels(
    server: XServer, boxes: tuple[PanelBox, PanelBox] | None = None
) -> tuple[Pixels, Pixels, int]:
    """What projector and mask show, and the brightest pixel of the rest of the screen.

    They fill the server's outputs, where `boxes` (x, y, width, height) do not say otherwise.
    """
    whole = root_pixels(server).copy()
    (pw, ph), (mw, mh) = server.projector_px, server.mask_px
    found = []
    for x, y, width, height in boxes or ((0, 0, pw, ph), (pw, 0, mw, mh)):
        part = whole[y : y + height, x : x + width]
        found.append(part.copy())
        part[...] = 0
    return found[0], found[1], int(whole.max())
