"""Pictures by which a bench is set up and judged by eye, drawn on a panel's own pixels.

Levels are 0..1, (height, width) each; row 0 is at the top. `docs/bench-bringup.md` says what each
is for.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_Levels = NDArray[np.float64]
_Size = tuple[int, int]
"""(width, height) in pixels."""

WEDGE_LEVELS = 17
"""Grey levels of a wedge: sixteenths of full light."""
_SPOKES = 36
"""Dark and bright pairs of a focus star."""
_STAR_SHARE, _CORE_PX = 0.3, 8.0
"""Diameter of a star over the panel's height; radius at which its spokes would blur on any
panel."""
_DOT_PITCH_PX, _DOT_RADIUS_PX = 32, 6.0
POSITIONS = 32
"""Places of what moves, over the width of a panel."""
FLASH_EVERY = 30
"""Refreshes from one flash to the next."""


def _checkerboard(size: _Size) -> _Levels:
    """Single pixels, bright and dark in turn; upper left one bright."""
    x, y = _raster(size)
    return np.asarray((x + y) % 2 == 0, dtype=np.float64)


def draw_wedge(size: _Size) -> _Levels:
    """Upright strips from black to full light, and below them the other way round."""
    x, y = _raster(size)
    step = x * WEDGE_LEVELS // size[0]
    return np.where(2 * y < size[1], step, WEDGE_LEVELS - 1 - step) / (WEDGE_LEVELS - 1.0)


def _stars(size: _Size) -> _Levels:
    """Focus stars in the middle and in all corners, each in a bright ring."""
    width, height = size
    x, y = _raster(size)
    radius_px = 0.5 * _STAR_SHARE * height
    found = np.zeros((height, width))
    inset = 1.15 * radius_px
    for across, down in (
        (0.5 * width, 0.5 * height),
        (inset, inset),
        (width - inset, inset),
        (inset, height - inset),
        (width - inset, height - inset),
    ):
        right, below = x + 0.5 - across, y + 0.5 - down
        far = np.hypot(right, below)
        spoke = np.floor(np.arctan2(below, right) * _SPOKES / np.pi).astype(np.int64) % 2 == 0
        inside = far < radius_px
        ring = (far >= radius_px) & (far < 1.08 * radius_px)
        found[ring | (inside & spoke) | (far < min(_CORE_PX, 0.2 * radius_px))] = 1.0
    return found


def draw_dot_grid(size: _Size) -> _Levels:
    """Round dots on a square grid."""
    x, y = _raster(size)
    right, below = ((v + 0.5) % _DOT_PITCH_PX - 0.5 * _DOT_PITCH_PX for v in (x, y))
    return np.asarray(np.hypot(right, below) < _DOT_RADIUS_PX, dtype=np.float64)


def draw_letter(size: _Size) -> _Levels:
    """A large F: a mirrored or turned panel is seen at a glance."""
    width, height = size
    x, y = _raster(size)
    across, down = (x + 0.5 - 0.5 * width) / height, (y + 0.5) / height
    stem = (across > -0.25) & (across < -0.09) & (down > 0.12) & (down < 0.88)
    top = (across > -0.25) & (across < 0.25) & (down > 0.12) & (down < 0.27)
    middle = (across > -0.25) & (across < 0.14) & (down > 0.42) & (down < 0.56)
    return (stem | top | middle).astype(np.float64)


def _edges(size: _Size) -> list[_Levels]:
    """An upright edge that moves to the right by a step a refresh, bright behind it."""
    x, _ = _raster(size)
    return [(x * POSITIONS < (k + 1) * size[0]).astype(np.float64) for k in range(POSITIONS)]


def draw_bars(size: _Size) -> list[_Levels]:
    """A bar that moves by its width each refresh: a photo shows how many refreshes it caught. Every
    eighth place is taller."""
    x, y = _raster(size)
    found = []
    for k in range(POSITIONS):
        tall = 1.0 if k % 8 == 0 else 0.5
        found.append(
            ((x * POSITIONS // size[0] == k) & (y >= (1.0 - tall) * size[1])).astype(float)
        )
    return found


def flash(size: _Size) -> list[_Levels]:
    """One bright refresh, then black for long enough that the eye sees separate flashes."""
    width, height = size
    return [np.full((height, width), float(k == 0)) for k in range(FLASH_EVERY)]


STILL: dict[str, Callable[[_Size], _Levels]] = {
    "pixels": _checkerboard,
    "wedge": draw_wedge,
    "star": _stars,
    "dots": draw_dot_grid,
    "letter": draw_letter,
}
"""Pictures that stay; both panels show them, each on its own pixels."""
MOVING: dict[str, Callable[[_Size], list[_Levels]]] = {
    "flash": flash,
    "edge": _edges,
    "bar": draw_bars,
}
"""Pictures of several refreshes, over and over."""


def _raster(size: _Size) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of all pixels, (height, width) each."""
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    return x, y
