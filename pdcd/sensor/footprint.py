"""Shares of pieces of the field in the light of each quad of a camera.

A quad sees a small parallelogram of the field, blurred by the lens. The field is cut along both
axes, into cells or into parts of cells. The footprint says which share of each quad's light comes
from which piece. A share is exact where only one straight edge cuts the quad; where two edges cross
within a turned quad, it is the product of the shares along the two axes.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats, Indices
from pdcd.panels.map import Map
from pdcd.sensor.quad_places import PLACE_ROWS, SNAP, PlaceNodes, find_upright_axes

_REACH_SIGMAS = 4.0
"""Standard deviations up to which blur counts; less than a ten-thousandth lies beyond."""
_THIN = 1e-6
"""Least width of a parallelogram's slope, relative to its length: it must not be 0, as it divides.
"""
_TOUCH = 1e-6
"""Share of half its size by which rounding may move a quad in the field beyond the field's edge."""
_THREADS = 2
"""Threads for a footprint; the sums of a band of rows release the interpreter's lock."""
_CLOSE = 1e-12
"""A place no further than this from an edge, in cells, lies on it."""

Cuts = tuple[tuple[float, ...], tuple[float, ...]]
"""Where each cell is cut along rows and columns, 0 and 1 included."""


@dataclass(frozen=True, eq=False)
class Footprint:
    """Shares of (R, C) pieces in a frame of (h, w) quads.

    known : (h, w) bool, quads that lie wholly within the field.
    inside : (h, w) float32 or None, share of a quad's light that comes from the field: blur makes
        it less than 1 near the border; None where it is 1 for all known quads.
    """

    known: Bools
    inside: NDArray[np.float32] | None
    _shares: _Axes | _Whole

    @cached_property
    def area(self) -> Floats:
        """Sum of the shares of each piece, (R, C), over quads that lie wholly within the field."""
        return self.collect(self.known)

    def gather(self, values: NDArray[Any]) -> Floats:
        """Mean of values of pieces (R, C) over what each quad sees: (h, w), 0 outside the field."""
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
    shares: scipy.sparse.csr_array

    def gather(self, values: NDArray[Any]) -> Floats:
        flat = np.asarray(values, dtype=np.float64).ravel()
        return np.asarray(self.shares @ flat).reshape(self.frame)

    def collect(self, image: NDArray[Any], *, squares: bool) -> Floats:
        shares = self.shares
        if squares:
            parts = shares.data**2, shares.indices, shares.indptr
            shares = scipy.sparse.csr_array(parts, shape=shares.shape)
        flat = np.asarray(image, dtype=np.float64).ravel()
        return np.asarray(shares.T @ flat).reshape(self.pieces)


@dataclass(frozen=True, eq=False)
class _Axes:
    """Shares of an upright, mirrored or quarter-turned frame: products of two axes.

    down, right : sparse (h, pieces), (w, pieces). `turned`: rows of quads lie along columns of
    pieces.
    """

    down: scipy.sparse.csr_array
    right: scipy.sparse.csr_array
    turned: bool

    def gather(self, values: NDArray[Any]) -> Floats:
        table = np.asarray(values, dtype=np.float64)
        table = table.T if self.turned else table
        across = np.ascontiguousarray((self.right @ np.ascontiguousarray(table.T)).T)
        return np.asarray(self.down @ across)

    @cached_property
    def _sums(self) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
        """Matrices that sum over pieces, down and right: of shares, and of their squares."""
        both = self.down, self.right
        (down, right), (down2, right2) = both, (axis.power(2) for axis in both)
        return (down.T, right.T), (down2.T, right2.T)

    def collect(self, image: NDArray[Any], *, squares: bool) -> Floats:
        down, right = self._sums[squares]
        rows = down @ np.asarray(image, dtype=np.float64)
        table = np.asarray((right @ np.ascontiguousarray(rows.T)).T)
        return table.T if self.turned else table


def compute_footprint(
    map_: Map,
    frame: tuple[int, int],
    grid: tuple[int, int],
    cuts: Cuts,
    blur_quads: float,
) -> Footprint:
    """Footprint of a camera's frame on pieces of the field.

    Parameters
    ----------
    map_ : from quads to the field.
    frame, grid : rows and columns of quads, and of the cells of the field.
    cuts : where each cell is cut into pieces.
    blur_quads : standard deviation of the blur between field and sensor, in quads.
    """
    lines = find_upright_axes(map_, grid)
    if lines is None:
        return _scattered(map_, frame, grid, cuts, blur_quads)
    turned, (y, x) = lines  # along rows of quads, and along columns: start and step, in cells
    pieces = _Pieces(grid[0], cuts[0]), _Pieces(grid[1], cuts[1])
    of_rows, of_cols = (pieces[1], pieces[0]) if turned else pieces
    down, in_down, known_down = _axis(frame[0], y, of_rows, blur_quads)
    right, in_right, known_right = _axis(frame[1], x, of_cols, blur_quads)
    inside = None
    if blur_quads > 0.0:
        inside = np.outer(in_down, in_right).astype(np.float32)
    known: Bools = np.logical_and.outer(known_down, known_right)
    return Footprint(known, inside, _Axes(down, right, turned))


def _axis(
    count: int, line: tuple[float, float], pieces: _Pieces, blur_quads: float
) -> tuple[scipy.sparse.csr_array, Floats, Bools]:
    """Shares along one axis, sparse (count, pieces), scaled to add up to 1 for each quad; their
    sums before; and which quads lie wholly inside."""
    start, step = line
    ends = np.rint((start + step * np.arange(count + 1.0)) * SNAP) / SNAP
    low, high = np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:])
    sigma = blur_quads * abs(step)
    edges = pieces.edges
    first, number = pieces.touched(low - _REACH_SIGMAS * sigma, high + _REACH_SIGMAS * sigma)
    quad, piece = _expanded(first, number)
    lo, hi = low[quad], high[quad]
    share = _below_box(edges[piece + 1], lo, hi, sigma) - _below_box(edges[piece], lo, hi, sigma)
    sums = np.bincount(quad, share, minlength=count)
    known: Bools = (low >= edges[0]) & (high <= edges[-1])
    shape = count, edges.size - 1
    share = share / np.where(sums > 0.0, sums, 1.0)[quad]
    kept = share > 0.0
    matrix = scipy.sparse.csr_array((share[kept], (quad[kept], piece[kept])), shape=shape)
    return matrix, np.asarray(sums, dtype=np.float64), known


def _scattered(
    map_: Map,
    frame: tuple[int, int],
    grid: tuple[int, int],
    cuts: Cuts,
    blur_quads: float,
) -> Footprint:
    """The footprint of any map, some rows of quads at a time."""
    of_rows, of_cols = _Pieces(grid[0], cuts[0]), _Pieces(grid[1], cuts[1])
    pieces = of_rows.count, of_cols.count
    known, inside = np.empty(frame, np.bool_), np.empty(frame, np.float32)
    nodes = PlaceNodes(map_, frame, grid)

    def band(start: int) -> tuple[Indices, NDArray[np.int32], Floats]:
        here = slice(start, min(start + PLACE_ROWS, frame[0]))
        u, v = nodes.places(here)
        across, down = nodes.slopes(here)
        x = _Marginal.of(u.ravel(), across, blur_quads, of_cols)
        y = _Marginal.of(v.ravel(), down, blur_quads, of_rows)
        count, column, share, sums = _crossed(y, x, pieces[1])
        known[here] = (x.known & y.known).reshape(u.shape)
        inside[here] = sums.reshape(u.shape)
        return count, column, share

    with ThreadPoolExecutor(_THREADS) as pool:
        counts, columns, shares = zip(*pool.map(band, range(0, frame[0], PLACE_ROWS)), strict=True)
    ends = np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(np.int64)
    whole = scipy.sparse.csr_array(
        (np.concatenate(shares), np.concatenate(columns), ends.astype(np.int32)),
        shape=(frame[0] * frame[1], pieces[0] * pieces[1]),
    )
    return Footprint(known, inside if blur_quads > 0.0 else None, _Whole(frame, pieces, whole))


@dataclass(frozen=True, eq=False)
class _Marginal:
    """One axis of the footprints of many quads: two boxes of the half widths `sides`, convolved
    with each other and with a Gaussian.

    first, number : first piece that a quad touches, and the number of them; alone : the quad lies
        within that one piece.
    """

    centre: Floats
    sides: tuple[Floats, Floats]
    sigma: Floats | None
    edges: Floats
    first: Indices
    number: Indices
    alone: Bools
    known: Bools

    @classmethod
    def of(
        cls, centre: Floats, slope: tuple[Floats, Floats], blur_quads: float, pieces: _Pieces
    ) -> _Marginal:
        """The axis for quads at `centre`, (Q,), whose place moves by `slope` from quad to quad."""
        sides = 0.5 * np.abs(slope[0]).ravel(), 0.5 * np.abs(slope[1]).ravel()
        half = sides[0] + sides[1]
        sigma = None
        reach = half
        if blur_quads > 0.0:
            sigma = 2.0 * blur_quads * np.hypot(*sides)
            reach = half + _REACH_SIGMAS * sigma
        low, high = centre - reach, centre + reach
        edges = pieces.edges
        first, number = pieces.touched(low, high)
        alone = (number == 1) & (low >= edges[0]) & (high <= edges[-1])
        known = (centre - (1.0 - _TOUCH) * half >= edges[0]) & (
            centre + (1.0 - _TOUCH) * half <= edges[-1]
        )
        return cls(centre, sides, sigma, edges, first, number, alone, known)

    def shares(self, quad: Indices, piece: Indices) -> Floats:
        """Shares of pieces in quads, (E,) each."""
        share = np.ones(quad.size)
        cut = np.flatnonzero(~self.alone[quad])
        some, which = quad[cut], piece[cut]
        share[cut] = self._below(self.edges[which + 1], some) - self._below(self.edges[which], some)
        return share

    def _below(self, edge: Floats, quad: Indices) -> Floats:
        x, one, other = edge - self.centre[quad], self.sides[0][quad], self.sides[1][quad]
        long = np.maximum(one, other)
        short = np.maximum(np.minimum(one, other), _THIN * long)
        sigma = None if self.sigma is None else self.sigma[quad]
        total = _twice(x + long + short, sigma) - _twice(x + long - short, sigma)
        total += _twice(x - long - short, sigma) - _twice(x - long + short, sigma)
        return np.clip(total / (4.0 * long * short), 0.0, 1.0)


class _Pieces:
    """The pieces of all cells along an axis."""

    def __init__(self, cells: int, cuts: tuple[float, ...]) -> None:
        self._cuts = cuts
        starts = np.arange(cells)[:, None] + np.array(cuts[:-1])
        self.edges = np.append(starts.ravel(), float(cells))
        self.count = self.edges.size - 1

    def touched(self, low: Floats, high: Floats) -> tuple[Indices, Indices]:
        """First piece between `low` and `high`, and the number of pieces; 0 outside the field."""
        first, end = self._of(low), self._of(high - _CLOSE)
        there = (high > 0.0) & (low < self.edges[-1])
        return first, np.where(there, end - first + 1, 0)

    def _of(self, places: Floats) -> Indices:
        """The piece in which a place lies; beyond the field, the first or the last piece."""
        cell = np.floor(places)
        part = places - cell
        piece = cell.astype(np.int64) * (len(self._cuts) - 1)
        for cut in self._cuts[1:-1]:
            piece += part >= cut
        return np.clip(piece, 0, self.count - 1, out=piece)


def _expanded(first: Indices, number: Indices) -> tuple[Indices, Indices]:
    """The pairs of a quad and a piece that it touches, (E,) each."""
    quad = np.repeat(np.arange(first.size), number)
    step = np.arange(quad.size) - np.repeat(np.cumsum(number) - number, number)
    return quad, first[quad] + step


def _crossed(
    y: _Marginal, x: _Marginal, across: int
) -> tuple[Indices, NDArray[np.int32], Floats, Floats]:
    """Products of two axes: the number of each quad's entries (Q,), their pieces and shares (E,),
    scaled to add up to 1 for each quad, and their sums before (Q,)."""
    number = y.number * x.number
    ends = np.cumsum(number)
    starts = ends - number
    share = np.ones(int(ends[-1]))
    column = np.empty(share.size, np.int32)
    sums = np.ones(number.size)
    alone = y.alone & x.alone  # most quads lie within one piece
    column[starts[alone]] = y.first[alone] * across + x.first[alone]
    cut = np.flatnonzero(~alone)
    entries = number[cut]
    quad = np.repeat(cut, entries)
    step = np.arange(quad.size) - np.repeat(np.cumsum(entries) - entries, entries)
    row, col = np.divmod(step, x.number[quad])
    row += y.first[quad]
    col += x.first[quad]
    parts = y.shares(quad, row) * x.shares(quad, col)
    sums[cut] = np.bincount(quad, parts, minlength=number.size)[cut]
    at = starts[quad] + step
    column[at] = row * across + col
    share[at] = parts / np.where(sums > 0.0, sums, 1.0)[quad]
    return number, column, share, sums


def _below_box(edge: Floats, low: Floats, high: Floats, sigma: float) -> Floats:
    """Share of a blurred box that lies below an edge."""
    if sigma == 0.0:
        return np.clip((edge - low) / (high - low), 0.0, 1.0)
    a, b = (edge - low) / sigma, (edge - high) / sigma
    below = a * scipy.special.ndtr(a) + _bell(a) - b * scipy.special.ndtr(b) - _bell(b)
    return np.asarray(np.clip(below * sigma / (high - low), 0.0, 1.0))


def _twice(x: Floats, sigma: Floats | None) -> Floats:
    """The second integral of a blurred step at 0."""
    if sigma is None:
        return 0.5 * np.maximum(x, 0.0) ** 2
    z = x / sigma
    grown: Floats = 0.5 * sigma**2 * ((z * z + 1.0) * scipy.special.ndtr(z) + z * _bell(z))
    return grown


def _bell(z: Floats) -> Floats:
    """Density of the normal distribution."""
    return np.asarray(np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi))
