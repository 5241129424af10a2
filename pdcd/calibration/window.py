"""The part of the field that projector, mask and camera share: only there patterns can be seen.

Panels whose shape differs from the projector's, or a camera that is zoomed in, leave out some of
it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map

_PLACES = 101
"""Places of the field along either axis that are checked."""
_EDGE = 0.04
"""Width of the window's border that is checked, and twice the step by which a side is moved."""
_SHARED = 0.9
"""Least share of a border that all three must share."""
_LEAST = 0.3
"""Least side of the window."""


@dataclass(frozen=True)
class Window:
    """A rectangle of the field, 0 to 1 across and down."""

    left: float = 0.0
    right: float = 1.0
    top: float = 0.0
    bottom: float = 1.0

    def across(self, x: Floats) -> Floats:
        """x of the field as a share of the window's width."""
        return np.asarray((x - self.left) / (self.right - self.left))

    def down(self, y: Floats) -> Floats:
        """y of the field as a share of the window's height."""
        return np.asarray((y - self.top) / (self.bottom - self.top))

    def x(self, share: Floats) -> Floats:
        """x of the field at a share of the window's width."""
        return np.asarray(self.left + share * (self.right - self.left))

    def y(self, share: Floats) -> Floats:
        """y of the field at a share of the window's height."""
        return np.asarray(self.top + share * (self.bottom - self.top))


WHOLE = Window()


def find_shared_window(mask: Map, camera: Map) -> Window:
    """The window of the field that mask and camera share; the projector fills the field.

    Sides are moved inwards, the worst first, until hardly anything along them lies off a device.
    Raises CalibrationError where less than a third of the field's width or height remains.
    """
    step = (np.arange(_PLACES) + 0.5) / _PLACES
    points = np.stack(np.meshgrid(step, step), axis=-1)
    good = np.ones(points.shape[:2], dtype=np.bool_)
    for device in (mask, camera):
        at = device.from_field(points)
        with np.errstate(invalid="ignore"):
            good &= ((at >= 0.0) & (at <= device.size_px)).all(axis=-1)
    window = WHOLE
    while True:
        sides = _sides(window, points, good)
        worst = min(sides, key=lambda side: sides[side])
        if sides[worst] >= _SHARED:
            return window
        moved = getattr(window, worst) + (_EDGE / 2.0) * (1.0 if worst in ("left", "top") else -1.0)
        window = replace(window, **{worst: moved})
        if min(window.right - window.left, window.bottom - window.top) < _LEAST:
            raise CalibrationError(
                "projector, mask and camera share hardly any of the field",
                device="camera",
                hint="move or zoom them so that the camera sees the projector's picture through "
                "the mask",
            )


def _sides(window: Window, points: Floats, good: NDArray[np.bool_]) -> dict[str, float]:
    """Share of the border along each side that is good."""
    x, y = window.across(points[..., 0]), window.down(points[..., 1])
    inside = (x >= 0.0) & (x <= 1.0) & (y >= 0.0) & (y <= 1.0)
    borders = {
        "left": x < _EDGE,
        "right": x > 1.0 - _EDGE,
        "top": y < _EDGE,
        "bottom": y > 1.0 - _EDGE,
    }
    return {side: float(good[inside & border].mean()) for side, border in borders.items()}
