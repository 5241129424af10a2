"""Where the quads of a camera lie among the cells, and values of cells between their centres."""

from __future__ import annotations

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.panels.map import Map
from pdcd.sensor.bands import run_in_bands

SNAP = 2.0**30
"""Edges of quads are rounded to this part of a cell: those on edges of pieces then lie on them."""
_ALIGNED = 1e-9
"""Share of the field: a map that turns a device by less, over its whole size, counts as upright."""
PLACE_ROWS = 64
"""Rows of quads looked at together; bounds the memory."""
_NODE_PX, _LEAST_NODES = 8, 64
"""Distance between quads whose places are computed, and the least number of them along a side that
has as many quads. Between them the error is below a hundredth of a quad for any usual lens."""
_NOWHERE = -1e3
"""Place, in fields, of quads that a map sends beyond infinity."""


def compute_quad_places(
    map_: Map, frame: tuple[int, int], grid: tuple[int, int]
) -> NDArray[np.float32]:
    """Where the centres of quads lie: (2, h, w) float32, across and down, in cells from the centre
    of the first one; far outside where the map has no place for them."""
    found = np.empty((2, *frame), dtype=np.float32)
    nodes = PlaceNodes(map_, frame, grid)

    def band(rows: slice) -> None:
        found[0, rows], found[1, rows] = nodes.places(rows)
        found[:, rows] -= np.float32(0.5)

    run_in_bands(frame[0], band)
    return found


def interpolate_between_cells(
    values: NDArray[np.float32], where: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Values of cells (rows, cols) at places from `compute_quad_places`, (h, w): bilinear between
    the centres of cells, constant beyond the outermost centres."""
    x, y = where
    seen = cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, dtype=np.float32)


def make_axis_weights(
    map_: Map, frame: tuple[int, int], grid: tuple[int, int]
) -> tuple[bool, scipy.sparse.csr_array, scipy.sparse.csr_array] | None:
    """The weights of that interpolation along the axes of an upright frame: whether it is turned by
    a quarter, and sparse (h, cells), (w, cells); None for other frames."""
    lines = find_upright_axes(map_, grid)
    if lines is None:
        return None
    turned, (y, x) = lines
    rows, cols = (grid[1], grid[0]) if turned else grid
    return turned, _between(frame[0], y, rows), _between(frame[1], x, cols)


def find_upright_axes(
    map_: Map, grid: tuple[int, int]
) -> tuple[bool, tuple[tuple[float, float], tuple[float, float]]] | None:
    """For a frame whose axes lie along those of the field: whether the axes are exchanged, and
    start and step in cells along rows and columns of quads; None for other frames."""
    if map_.bends:
        return None
    a, b, c, d, e, f, g, h, _ = (number / map_.homography[8] for number in map_.homography)
    width, height = map_.size_px
    rows, cols = grid
    if max(abs(g) * width, abs(h) * height) > _ALIGNED:
        return None
    if max(abs(b) * height, abs(d) * width) <= _ALIGNED:
        return False, ((f * rows, e * rows), (c * cols, a * cols))
    if max(abs(a) * width, abs(e) * height) <= _ALIGNED:
        return True, ((c * cols, b * cols), (f * rows, d * rows))
    return None


def _between(count: int, line: tuple[float, float], cells: int) -> scipy.sparse.csr_array:
    """Weights of the two cells whose centres enclose each quad's, sparse (count, cells)."""
    start, step = line
    centre = np.rint((start + step * (np.arange(count) + 0.5)) * SNAP) / SNAP
    at = np.clip(centre - 0.5, 0.0, cells - 1.0)
    first = np.minimum(at.astype(np.int64), max(cells - 2, 0))
    share = at - first
    quads = np.arange(count)
    both = np.concatenate([1.0 - share, share])
    columns = np.concatenate([first, np.minimum(first + 1, cells - 1)])
    kept = both > 0.0
    rows = np.concatenate([quads, quads])[kept]
    return scipy.sparse.csr_array((both[kept], (rows, columns[kept])), shape=(count, cells))


class PlaceNodes:
    """Places of quads, in cells, and their slopes from quad to quad: computed at some quads and
    interpolated between them."""

    def __init__(self, map_: Map, frame: tuple[int, int], grid: tuple[int, int]) -> None:
        rows, cols = (
            np.linspace(0.5, side - 0.5, max(2, min(side, max(_LEAST_NODES, side // _NODE_PX))))
            for side in frame
        )
        points = np.stack(np.meshgrid(cols, rows), axis=-1)
        size = np.array([grid[1], grid[0]])
        self._place = np.nan_to_num(map_.to_field(points), nan=_NOWHERE) * size
        self._slope = np.nan_to_num(map_.jacobian(points), nan=0.0) * size[:, None]
        self._down, self._right = _nodes(frame[0], rows.size), _nodes(frame[1], cols.size)

    def places(self, rows: slice) -> tuple[Floats, Floats]:
        """Places of the centres of some rows of quads, across and down."""
        return self._at(rows, self._place[..., 0]), self._at(rows, self._place[..., 1])

    def slopes(self, rows: slice) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Slopes (with x, with y) of the place across, and of the place down."""
        slope = self._slope
        across = self._at(rows, slope[..., 0, 0]), self._at(rows, slope[..., 0, 1])
        return across, (self._at(rows, slope[..., 1, 0]), self._at(rows, slope[..., 1, 1]))

    def _at(self, rows: slice, values: Floats) -> Floats:
        some = self._down[rows] @ values
        return np.ascontiguousarray((self._right @ np.ascontiguousarray(some.T)).T)


def _nodes(count: int, nodes: int) -> scipy.sparse.csr_array:
    """Linear interpolation from evenly spread nodes to quads, sparse (count, nodes)."""
    at = np.arange(count) * ((nodes - 1) / max(count - 1, 1))
    first = np.minimum(at.astype(np.int64), nodes - 2)
    share = at - first
    quads = np.arange(count)
    return scipy.sparse.csr_array(
        (
            np.concatenate([1.0 - share, share]),
            (np.concatenate([quads, quads]), np.concatenate([first, first + 1])),
        ),
        shape=(count, nodes),
    )
