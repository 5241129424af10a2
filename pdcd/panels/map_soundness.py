"""Whether a map can be used at all: finite, invertible, nowhere folded, on the field; and how large
the cells of the field are in a device's pixels.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.errors import ConfigError
from pdcd.panels.map import Map

_SAMPLES = 33
"""Points a side at which a map is checked, the device's corners included; more where a residual has
many nodes."""
_PER_NODE = 4
"""Points from one node of a residual to the next."""
MAX_NODES = 32
"""Most nodes of a residual a side: what needs more is not smooth."""
_MAX_SIDE_PX = 2**16
"""Most pixels of a device a side."""
_FARTHEST = 100.0
"""Most widths of the field to a device's corner: one further away is not on this bench."""
LEAST_SHARE = 0.25
"""Share of the field that a panel must cover: cells beyond it never get light."""


def check_map(map_: Map, device: str) -> Map:
    """The map itself. Raises ConfigError if it is not finite, singular, folded or far too large;
    `device` is the one that it belongs to."""
    width, height = map_.size_px
    numbers = [*map_.homography, *map_.radial, *map_.tangential]
    if not (0 < width <= _MAX_SIDE_PX and 0 < height <= _MAX_SIDE_PX):
        raise _unsound(
            device, f"has {width} x {height} pixels; 1 to {_MAX_SIDE_PX} a side are read"
        )
    if not np.isfinite(numbers).all():
        raise _unsound(device, "has numbers that are not finite")
    nodes = _nodes(map_, device)
    full = np.array(map_.homography).reshape(3, 3)
    if not np.isfinite(full).all() or np.linalg.matrix_rank(full) < 3:
        raise _unsound(device, "has a singular homography")
    samples = max(_SAMPLES, _PER_NODE * (max(nodes.shape[:2]) - 1) + 1)
    x, y = np.meshgrid(np.linspace(0.0, width, samples), np.linspace(0.0, height, samples))
    points = np.stack([x, y], axis=-1)
    with np.errstate(all="ignore"):
        field, turned = map_.to_field(points), np.linalg.det(map_.jacobian(points))
    if not np.isfinite(field).all():
        raise _unsound(device, "sends part of the device beyond infinity")
    if np.abs(field).max() > _FARTHEST:
        raise _unsound(device, f"places a corner {np.abs(field).max():.3g} fields away")
    if not (turned > 0.0).all() and not (turned < 0.0).all():
        raise _unsound(device, "folds: some places of the field have two pixels")
    back = map_.from_field(field)
    if not np.allclose(back, points, rtol=0.0, atol=1e-6 * max(width, height)):
        raise _unsound(device, "cannot be inverted over the whole device")
    return map_


@lru_cache(maxsize=32)
def compute_field_share(map_: Map, points: int = 64) -> float:
    """The share of the field that the device covers, 0 to 1, from so many points a side."""
    middle = (np.arange(points) + 0.5) / points
    at = map_.from_field(np.stack(np.meshgrid(middle, middle), axis=-1))
    with np.errstate(invalid="ignore"):  # no number where the field has no point of the device
        return float(np.mean(((at >= 0.0) & (at <= map_.size_px)).all(axis=-1)))


def check_share(map_: Map, device: str, least: float = LEAST_SHARE) -> Map:
    """The map itself. Raises ConfigError if the device misses the field, or covers less of it than
    ``least``; with 0, only if it misses the field."""
    covered = compute_field_share(map_)
    if covered == 0.0:
        raise _unsound(device, "places it beside the field")
    if covered < least:
        raise _unsound(
            device, f"covers {covered:.1%} of the field only; {least:.0%} at least are needed"
        )
    return map_


def _nodes(map_: Map, device: str) -> NDArray[np.float64]:
    """The residual as an array (rows, cols, 2), or one of shape (1, 1, 2) where there is none."""
    if not map_.residual:
        return np.zeros((1, 1, 2))
    try:
        nodes = np.array(map_.residual, dtype=np.float64)
    except (ValueError, TypeError):
        nodes = np.empty(0)
    sides = nodes.shape[:2]
    if nodes.ndim != 3 or nodes.shape[2] != 2 or not all(2 <= n <= MAX_NODES for n in sides):
        raise _unsound(
            device,
            f"has a residual that is no grid of 2 x 2 to {MAX_NODES} x {MAX_NODES} nodes",
        )
    if not np.isfinite(nodes).all():
        raise _unsound(device, "has a residual that is not finite")
    return nodes


def _unsound(device: str, what: str) -> ConfigError:
    return ConfigError(
        f"the map of the {device} {what}",
        device=device,
        hint="correct its place in the configuration, or calibrate the geometry again",
    )


_CELL_SAMPLES = 64
"""Most cells a side at which a map is evaluated."""
_EDGE_POINTS = 257
"""Points along each edge of the field at which it is checked whether a device reaches so far."""
SHORT_PX = 0.5
"""Pixels by which a device may end short of the field's edge and still cover it."""


def list_cell_centres(grid: tuple[int, int]) -> Floats:
    """Centres of some cells on the field, (n, 2), first and last rows and columns among them."""
    down, right = (_centres(cells) for cells in grid)
    return np.stack(np.meshgrid(right, down), axis=-1).reshape(-1, 2)


def find_points_on_device(map_: Map, points_px: Floats) -> NDArray[np.bool_]:
    """Which points (n, 2) lie on the device's pixels; NaN does not."""
    return np.asarray(np.all((points_px >= 0.0) & (points_px <= map_.size_px), axis=-1))


def measure_cell_sides(map_: Map, points_px: Floats, grid: tuple[int, int]) -> tuple[float, float]:
    """Fewest and most pixels along a cell's side at points of the device, (n, 2); 0 if there are no
    points.

    They are measured in the directions in which a step of one pixel leads furthest, and least far.
    """
    if not len(points_px):
        return 0.0, 0.0
    rows, cols = grid
    slopes = map_.jacobian(points_px) * np.array([[cols], [rows]])
    steps = np.linalg.svd(slopes, compute_uv=False)
    return float(1.0 / steps.max()), float(1.0 / steps.min())


@lru_cache(maxsize=32)
def find_fewest_pixels(map_: Map, grid: tuple[int, int]) -> float | None:
    """Fewest pixels along the side of a cell that lies on the device; None where none does."""
    points = map_.from_field(list_cell_centres(grid))
    points = points[find_points_on_device(map_, points)]
    return measure_cell_sides(map_, points, grid)[0] if len(points) else None


def is_field_covered(map_: Map) -> bool:
    """Whether the device has pixels all over the field. Devices have no holes, so it has if it
    reaches all of the field's border."""
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)
    ends = np.zeros(_EDGE_POINTS), np.ones(_EDGE_POINTS)
    border = [np.stack(pair, axis=-1) for end in ends for pair in ((along, end), (end, along))]
    at = map_.from_field(np.concatenate(border))
    with np.errstate(invalid="ignore"):
        reached = (at >= -SHORT_PX) & (at <= np.array(map_.size_px) + SHORT_PX)
    return bool(reached.all())


def _centres(cells: int) -> Floats:
    """Centres of some cells along one side of the field, the first and the last among them."""
    some = np.unique(np.linspace(0, cells - 1, min(cells, _CELL_SAMPLES)).round())
    return np.asarray((some + 0.5) / cells)
