"""Shares of pieces of the field in what each quad of a camera sees.

A quad sees a small parallelogram of the field, blurred by the lens. The field is cut along both
axes, into cells or into parts of cells. The footprint says which share of each quad's light comes
from which piece. Along each axis it is exact for a piece that is cut off by a straight edge; where
two edges cross within a turned quad, shares are the product of those along the axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy.special
from numpy.typing import NDArray
from scipy import sparse

from pdcd.maps.map import Map

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]

REACH_SIGMAS = 4.0
"""How far blur is followed; what is beyond is less than a ten-thousandth."""
SNAP = 2.0**30
"""Edges of quads are rounded to this part of a cell: those on edges of pieces then lie on them."""
ALIGNED = 1e-9
"""Of the field: a map that turns a device by less over its whole size is not turned."""
THIN = 1e-6
"""Least width of a parallelogram's slope, over its length: 0 would be divided by."""
ROWS = 64
"""Rows of quads looked at together; bounds the memory."""
NODE_PX = 16
"""Distance of the quads whose Jacobians are worked out; between them it is interpolated."""


@dataclass(frozen=True, eq=False)
class Footprint:
    """Shares of (R, C) pieces in a frame of (h, w) quads.

    known : (h, w) bool, quads that lie wholly within the field.
    inside : (h, w) float32 or None, share of a quad's light that comes from the field, by blur less
        than 1 near its border; None where that is 1 for all known quads.
    """

    known: Bools
    inside: NDArray[np.float32] | None
    _shares: _Axes | _Whole

    def gather(self, values: NDArray[Any]) -> Floats:
        """Mean over each quad of values of pieces: (R, C) -> (h, w), 0 outside the field."""
        return self._shares.gather(values)

    def collect(self, image: NDArray[Any], *, squares: bool = False) -> Floats:
        """Sums over each piece of ``share * image``, (h, w) -> (R, C); with `squares` of
        ``share^2 * image``."""
        return self._shares.collect(image, squares=squares)


@dataclass(frozen=True, eq=False)
class _Whole:
    """Shares of any frame: sparse (h * w, R * C)."""

    frame: tuple[int, int]
    pieces: tuple[int, int]
    shares: sparse.csr_array

    def gather(self, values: NDArray[Any]) -> Floats:
        flat = np.asarray(values, dtype=np.float64).ravel()
        return np.asarray(self.shares @ flat).reshape(self.frame)

    def collect(self, image: NDArray[Any], *, squares: bool) -> Floats:
        shares = self.shares
        if squares:
            parts = shares.data**2, shares.indices, shares.indptr
            shares = sparse.csr_array(parts, shape=shares.shape)
        flat = np.asarray(image, dtype=np.float64).ravel()
        return np.asarray(shares.T @ flat).reshape(self.pieces)


@dataclass(frozen=True, eq=False)
class _Axes:
    """Shares of an upright, mirrored or quarter-turned frame: products of two axes.

    down, right : sparse (h, pieces), (w, pieces). `turned`: rows of quads lie along columns of
    pieces.
    """

    down: sparse.csr_array
    right: sparse.csr_array
    turned: bool

    def gather(self, values: NDArray[Any]) -> Floats:
        table = np.asarray(values, dtype=np.float64)
        table = table.T if self.turned else table
        across = np.ascontiguousarray((self.right @ np.ascontiguousarray(table.T)).T)
        return np.asarray(self.down @ across)

    def collect(self, image: NDArray[Any], *, squares: bool) -> Floats:
        down, right = self.down, self.right
        if squares:
            down, right = down.power(2), right.power(2)
        rows = down.T @ np.asarray(image, dtype=np.float64)
        table = np.asarray((right.T @ np.ascontiguousarray(rows.T)).T)
        return table.T if self.turned else table


def footprint(
    map_: Map,
    frame: tuple[int, int],
    grid: tuple[int, int],
    edges: tuple[Floats, Floats],
    blur_quads: float,
) -> Footprint:
    """Footprint of a camera's frame on pieces of the field.

    Parameters
    ----------
    map_ : from quads to the field.
    frame, grid : rows and columns of quads, and of the cells of the field.
    edges : of the pieces along rows and columns, ascending, in cells, from 0 to the grid's size.
    blur_quads : standard deviation of the blur between field and sensor, in quads.
    """
    lines = _upright(map_, grid)
    if lines is None:
        return _scattered(map_, frame, grid, edges, blur_quads)
    turned, (y, x) = lines  # along rows of quads, and along columns: start and step, in cells
    of_rows, of_cols = (edges[1], edges[0]) if turned else edges
    down, in_down, known_down = _axis(frame[0], y, of_rows, blur_quads)
    right, in_right, known_right = _axis(frame[1], x, of_cols, blur_quads)
    inside = None
    if blur_quads > 0.0:
        inside = np.outer(in_down, in_right).astype(np.float32)
    known: Bools = np.logical_and.outer(known_down, known_right)
    return Footprint(known, inside, _Axes(down, right, turned))


def places(map_: Map, frame: tuple[int, int], grid: tuple[int, int]) -> NDArray[np.float32]:
    """Where the centres of quads lie: (2, h, w) float32, across and down, in cells; far outside
    where the map has no place for them."""
    found = np.empty((2, *frame), dtype=np.float32)
    for start in range(0, frame[0], ROWS):
        u, v = _centres(map_, frame, grid, start)
        found[0, start : start + ROWS], found[1, start : start + ROWS] = u, v
    return found


def bilinear(values: Floats, where: NDArray[np.float32]) -> NDArray[np.float32]:
    """Values of cells (rows, cols) at places of `places`, (h, w): bilinear between the centres of
    cells, beyond the outermost ones as there."""
    x, y = where[0] - np.float32(0.5), where[1] - np.float32(0.5)
    seen = cv2.remap(
        values.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(seen, dtype=np.float32)


def between_cells(
    map_: Map, frame: tuple[int, int], grid: tuple[int, int]
) -> tuple[bool, sparse.csr_array, sparse.csr_array] | None:
    """The same along the axes of an upright frame: whether it is a quarter turned, and sparse (h,
    cells), (w, cells); None for other frames."""
    lines = _upright(map_, grid)
    if lines is None:
        return None
    turned, (y, x) = lines
    rows, cols = (grid[1], grid[0]) if turned else grid
    return turned, _between(frame[0], y, rows), _between(frame[1], x, cols)


def _upright(
    map_: Map, grid: tuple[int, int]
) -> tuple[bool, tuple[tuple[float, float], tuple[float, float]]] | None:
    """Start and step in cells, along rows and columns of quads, of a frame whose axes are those of
    the field, and whether they are exchanged; None for others."""
    if any(map_.radial) or any(map_.tangential) or map_.residual:
        return None
    a, b, c, d, e, f, g, h, _ = (number / map_.homography[8] for number in map_.homography)
    width, height = map_.size_px
    rows, cols = grid
    if max(abs(g) * width, abs(h) * height) > ALIGNED:
        return None
    if max(abs(b) * height, abs(d) * width) <= ALIGNED:
        return False, ((f * rows, e * rows), (c * cols, a * cols))
    if max(abs(a) * width, abs(e) * height) <= ALIGNED:
        return True, ((c * cols, b * cols), (f * rows, d * rows))
    return None


def _axis(
    count: int, line: tuple[float, float], edges: Floats, blur_quads: float
) -> tuple[sparse.csr_array, Floats, Bools]:
    """Shares along one axis, each quad's adding up to 1: sparse (count, pieces); what they added up
    to before; and which quads lie wholly inside."""
    start, step = line
    ends = np.rint((start + step * np.arange(count + 1.0)) * SNAP) / SNAP
    low, high = np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:])
    sigma = blur_quads * abs(step)
    first, number = _touched(low - REACH_SIGMAS * sigma, high + REACH_SIGMAS * sigma, edges)
    quad, piece = _expanded(first, number)
    lo, hi = low[quad], high[quad]
    share = _below_box(edges[piece + 1], lo, hi, sigma) - _below_box(edges[piece], lo, hi, sigma)
    sums = np.bincount(quad, share, minlength=count)
    known: Bools = (low >= edges[0]) & (high <= edges[-1])
    shape = count, edges.size - 1
    share = share / np.where(sums > 0.0, sums, 1.0)[quad]
    kept = share > 0.0
    matrix = sparse.csr_array((share[kept], (quad[kept], piece[kept])), shape=shape)
    return matrix, np.asarray(sums, dtype=np.float64), known


def _between(count: int, line: tuple[float, float], cells: int) -> sparse.csr_array:
    """Weights of the two cells whose centres are beside each quad's, sparse (count, cells)."""
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
    return sparse.csr_array((both[kept], (rows, columns[kept])), shape=(count, cells))


def _scattered(
    map_: Map,
    frame: tuple[int, int],
    grid: tuple[int, int],
    edges: tuple[Floats, Floats],
    blur_quads: float,
) -> Footprint:
    """The footprint of any map, some rows of quads at a time."""
    pieces = edges[0].size - 1, edges[1].size - 1
    known, inside = np.empty(frame, np.bool_), np.empty(frame, np.float32)
    counts, columns, shares = [], [], []
    slopes = _Slopes(map_, frame, grid)
    for start in range(0, frame[0], ROWS):
        u, v = _centres(map_, frame, grid, start)
        here = slice(start, start + u.shape[0])
        across, down = slopes.at(here)
        x = _Marginal.of(u.ravel(), across, blur_quads, edges[1])
        y = _Marginal.of(v.ravel(), down, blur_quads, edges[0])
        count, column, share, sums = _crossed(y, x, pieces[1])
        known[here] = (x.known & y.known).reshape(u.shape)
        inside[here] = sums.reshape(u.shape)
        counts.append(count)
        columns.append(column)
        shares.append(share)
    ends = np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(np.int64)
    whole = sparse.csr_array(
        (np.concatenate(shares), np.concatenate(columns), ends.astype(np.int32)),
        shape=(frame[0] * frame[1], pieces[0] * pieces[1]),
    )
    return Footprint(known, inside if blur_quads > 0.0 else None, _Whole(frame, pieces, whole))


@dataclass(frozen=True, eq=False)
class _Marginal:
    """One axis of the footprints of many quads: a box of half width `long`, smeared by one of half
    width `short` and by a Gaussian.

    first, number : first piece that it touches, and how many; alone : it lies within that one.
    """

    centre: Floats
    long: Floats
    short: Floats
    sigma: Floats | None
    edges: Floats
    first: Indices
    number: Indices
    alone: Bools
    known: Bools

    @classmethod
    def of(
        cls, centre: Floats, slope: tuple[Floats, Floats], blur_quads: float, edges: Floats
    ) -> _Marginal:
        """Of quads at `centre`, (Q,), whose place moves by `slope` from quad to quad."""
        sides = [0.5 * np.abs(side).ravel() for side in slope]
        long = np.maximum(*sides)
        short = np.maximum(np.minimum(*sides), THIN * long)
        half = sides[0] + sides[1]
        sigma = None
        reach = half
        if blur_quads > 0.0:
            sigma = 2.0 * blur_quads * np.hypot(*sides)
            reach = half + REACH_SIGMAS * sigma
        low, high = centre - reach, centre + reach
        first, number = _touched(low, high, edges)
        alone = (number == 1) & (low >= edges[0]) & (high <= edges[-1])
        close = 1e-6 * half
        known = (centre - half >= edges[0] - close) & (centre + half <= edges[-1] + close)
        return cls(centre, long, short, sigma, edges, first, number, alone, known)

    def shares(self, quad: Indices, piece: Indices) -> Floats:
        """Shares of pieces in quads, (E,) each."""
        share = np.ones(quad.size)
        cut = np.flatnonzero(~self.alone[quad])
        some, which = quad[cut], piece[cut]
        share[cut] = self._below(self.edges[which + 1], some) - self._below(self.edges[which], some)
        return share

    def _below(self, edge: Floats, quad: Indices) -> Floats:
        x, long, short = edge - self.centre[quad], self.long[quad], self.short[quad]
        sigma = None if self.sigma is None else self.sigma[quad]
        total = _twice(x + long + short, sigma) - _twice(x + long - short, sigma)
        total += _twice(x - long - short, sigma) - _twice(x - long + short, sigma)
        return np.clip(total / (4.0 * long * short), 0.0, 1.0)


class _Slopes:
    """How the place of a quad, in cells, moves to the next quad of its row and its column."""

    def __init__(self, map_: Map, frame: tuple[int, int], grid: tuple[int, int]) -> None:
        height, width = frame
        rows = np.linspace(0.5, height - 0.5, 2 + height // NODE_PX)
        cols = np.linspace(0.5, width - 0.5, 2 + width // NODE_PX)
        x, y = np.meshgrid(cols, rows)
        slope = map_.jacobian(np.stack([x, y], axis=-1))
        slope[..., 0, :] *= grid[1]
        slope[..., 1, :] *= grid[0]
        self._slope = np.nan_to_num(slope, nan=0.0)
        self._down = _nodes(height, rows.size)
        self._right = _nodes(width, cols.size)

    def at(self, rows: slice) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """(with x, with y) of the place across, and of that down, of some rows of quads."""
        down = self._down[rows]
        found = [
            np.asarray(down @ np.ascontiguousarray((self._right @ self._slope[..., i, j].T).T))
            for i in (0, 1)
            for j in (0, 1)
        ]
        return (found[0], found[1]), (found[2], found[3])


def _nodes(count: int, nodes: int) -> sparse.csr_array:
    """Linear interpolation from evenly spread nodes to quads, sparse (count, nodes)."""
    at = np.arange(count) * ((nodes - 1) / max(count - 1, 1))
    first = np.minimum(at.astype(np.int64), nodes - 2)
    share = at - first
    quads = np.arange(count)
    return sparse.csr_array(
        (
            np.concatenate([1.0 - share, share]),
            (np.concatenate([quads, quads]), np.concatenate([first, first + 1])),
        ),
        shape=(count, nodes),
    )


def _centres(
    map_: Map, frame: tuple[int, int], grid: tuple[int, int], start: int
) -> tuple[Floats, Floats]:
    """Places of the centres of some rows of quads, across and down, in cells."""
    rows = np.arange(start, min(start + ROWS, frame[0])) + 0.5
    x, y = np.meshgrid(np.arange(frame[1]) + 0.5, rows)
    place = map_.to_field(np.stack([x, y], axis=-1))
    place = np.nan_to_num(place, nan=-1e3)
    return place[..., 0] * grid[1], place[..., 1] * grid[0]


def _touched(low: Floats, high: Floats, edges: Floats) -> tuple[Indices, Indices]:
    """First piece between `low` and `high`, and how many there are; none outside."""
    last = edges.size - 2
    first = np.clip(np.searchsorted(edges, low, side="right") - 1, 0, last)
    end = np.clip(np.searchsorted(edges, high, side="left") - 1, 0, last)
    there = (high > edges[0]) & (low < edges[-1])
    return first, np.where(there, end - first + 1, 0)


def _expanded(first: Indices, number: Indices) -> tuple[Indices, Indices]:
    """Every quad and piece that meet, (E,) each."""
    quad = np.repeat(np.arange(first.size), number)
    step = np.arange(quad.size) - np.repeat(np.cumsum(number) - number, number)
    return quad, first[quad] + step


def _crossed(
    y: _Marginal, x: _Marginal, across: int
) -> tuple[Indices, NDArray[np.int32], Floats, Floats]:
    """Products of two axes: entries of each quad (Q,), their pieces and shares (E,), adding up to 1
    for each quad, and what they added up to before (Q,)."""
    number = y.number * x.number
    quad = np.repeat(np.arange(number.size), number)
    step = np.arange(quad.size) - np.repeat(np.cumsum(number) - number, number)
    row, col = np.divmod(step, x.number[quad])
    row += y.first[quad]
    col += x.first[quad]
    share = y.shares(quad, row) * x.shares(quad, col)
    sums = np.bincount(quad, share, minlength=number.size)
    share /= np.where(sums > 0.0, sums, 1.0)[quad]
    return number, (row * across + col).astype(np.int32), share, np.asarray(sums, dtype=np.float64)


def _below_box(edge: Floats, low: Floats, high: Floats, sigma: float) -> Floats:
    """Share of a box, blurred, that lies below an edge."""
    if sigma == 0.0:
        return np.clip((edge - low) / (high - low), 0.0, 1.0)
    a, b = (edge - low) / sigma, (edge - high) / sigma
    below = a * scipy.special.ndtr(a) + _bell(a) - b * scipy.special.ndtr(b) - _bell(b)
    return np.asarray(np.clip(below * sigma / (high - low), 0.0, 1.0))


def _twice(x: Floats, sigma: Floats | None) -> Floats:
    """What a step at 0, blurred, comes to when it is integrated twice."""
    if sigma is None:
        return 0.5 * np.maximum(x, 0.0) ** 2
    z = x / sigma
    grown: Floats = 0.5 * sigma**2 * ((z * z + 1.0) * scipy.special.ndtr(z) + z * _bell(z))
    return grown


def _bell(z: Floats) -> Floats:
    """Density of the normal distribution."""
    return np.asarray(np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi))
