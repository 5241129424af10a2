"""How large the cells of the field are in a device's pixels."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.map import Map

Floats = NDArray[np.float64]

SAMPLES = 64
"""Cells a side, at most, at which a map is looked at."""
EDGE_POINTS = 257
"""Points along each edge of the field at which a device is asked whether it reaches so far."""
SHORT_PX = 0.5
"""A device that ends so little within the field has pixels as good as everywhere."""


def cell_centres(grid: tuple[int, int]) -> Floats:
    """Centres of some cells on the field, (n, 2), first and last rows and columns among them."""
    down, right = (_centres(cells) for cells in grid)
    return np.stack(np.meshgrid(right, down), axis=-1).reshape(-1, 2)


def on_device(map_: Map, points_px: Floats) -> NDArray[np.bool_]:
    """Which points (n, 2) lie on the device's pixels; NaN does not."""
    return np.asarray(np.all((points_px >= 0.0) & (points_px <= map_.size_px), axis=-1))


def pixels_across(map_: Map, points_px: Floats, grid: tuple[int, int]) -> tuple[float, float]:
    """Fewest and most pixels along a cell's side at points of the device, (n, 2); 0 of no points.

    The directions are those in which a step of one pixel leads furthest, and least far.
    """
    if not len(points_px):
        return 0.0, 0.0
    rows, cols = grid
    slopes = map_.jacobian(points_px) * np.array([[cols], [rows]])
    steps = np.linalg.svd(slopes, compute_uv=False)
    return float(1.0 / steps.max()), float(1.0 / steps.min())


@lru_cache(maxsize=32)
def fewest_pixels(map_: Map, grid: tuple[int, int]) -> float | None:
    """Fewest pixels along the side of a cell that lies on the device; None where none does."""
    points = map_.from_field(cell_centres(grid))
    points = points[on_device(map_, points)]
    return pixels_across(map_, points, grid)[0] if len(points) else None


def covers(map_: Map) -> bool:
    """Whether the device has pixels all over the field. One without holes does where it reaches
    all of the field's border."""
    along = np.linspace(0.0, 1.0, EDGE_POINTS)
    ends = np.zeros(EDGE_POINTS), np.ones(EDGE_POINTS)
    border = [np.stack(pair, axis=-1) for end in ends for pair in ((along, end), (end, along))]
    at = map_.from_field(np.concatenate(border))
    with np.errstate(invalid="ignore"):
        reached = (at >= -SHORT_PX) & (at <= np.array(map_.size_px) + SHORT_PX)
    return bool(reached.all())


def _centres(cells: int) -> Floats:
    """Centres of some cells along one side of the field, the first and the last among them."""
    some = np.unique(np.linspace(0, cells - 1, min(cells, SAMPLES)).round())
    return np.asarray((some + 0.5) / cells)
