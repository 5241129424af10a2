"""Quads of a camera that see pixels of all panels, and nothing beside them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.map import Map, find_pixels_on
from pdcd.panels.map_soundness import SHORT_PX

_REACH_SIGMAS = 2.0
"""Standard deviations of a blur within which a dark edge counts: further off, it takes 2 % of the
light at most."""


def find_covered_quads(camera: Map, panels: Sequence[Map], blur_quads: float) -> NDArray[np.bool_]:
    """Quads, (h, w), that see pixels of all the panels, and whose blur stays on those pixels.

    camera, panels : maps to one field. blur_quads : standard deviation of the lens' blur.
    """
    good = np.logical_and.reduce([find_pixels_on(camera, panel, -SHORT_PX) for panel in panels])
    for _ in range(math.ceil(_REACH_SIGMAS * blur_quads)):
        near = np.pad(good, 1, mode="edge")
        good = good & near[:-2, 1:-1] & near[2:, 1:-1] & near[1:-1, :-2] & near[1:-1, 2:]
    return np.asarray(good)
