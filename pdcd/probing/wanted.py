"""Wanted probing matrices, as sums of parts that are never stored whole.

Every row of Tables 1 and 2 of the paper is such a sum. n is a camera cell, m a projector cell, both
row-major over a grid of N cells. One convention for shifts everywhere: a shift w = (down, right)
pairs camera cell n with projector cell m = n + w (Table 1, row 4); cells whose partner lies beyond
the border have none.

Direct light, the diagonal, is treated separately from all other paths everywhere. So the sum that a
part can compute is `others`: the entries of a row without its diagonal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats, Indices

Grid = tuple[int, int]

WANTED_BLOCK = 512
"""Rows of a matrix without structure that are processed together; bounds the memory."""


class MatrixPart(Protocol):
    """One part P of a wanted matrix. All but `FullPart` answer in O(N) for each image."""

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1, (stop - start, N)."""
        ...

    def others(self, images: Floats) -> Floats:
        """Return ``sum over m != n of P_nm x_rm``, (R, N), for images x (R, N)."""
        ...

    def entries(self, column: Indices) -> Floats:
        """Return P_nm at m = column_n, (N,); 0 where that is -1."""
        ...

    def overlap(self, other: MatrixPart, weights: Floats) -> Floats:
        """Return ``sum over m != n of P_nm other_nm weights_m``, (N,), for weights (N,)."""
        ...

    def product(self) -> tuple[Floats, Floats] | None:
        """Camera and projector side, (N,) each, of a part that is their product; else None."""
        ...


@dataclass(frozen=True, eq=False)
class OuterPart:
    """``camera_n * projector_m``: a region, an illumination, a product of both."""

    camera: Floats
    projector: Floats

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        return np.outer(self.camera[start:stop], self.projector)

    def others(self, images: Floats) -> Floats:
        """See `MatrixPart.others`."""
        lit = images * self.projector
        arriving = lit.sum(axis=1, keepdims=True) - lit
        return np.asarray(self.camera * arriving)

    def entries(self, column: Indices) -> Floats:
        """See `MatrixPart.entries`."""
        return np.where(column >= 0, self.camera * self.projector[column], 0.0)

    def overlap(self, other: MatrixPart, weights: Floats) -> Floats:
        """See `MatrixPart.overlap`."""
        return np.asarray(self.camera * other.others((self.projector * weights)[None])[0])

    def product(self) -> tuple[Floats, Floats]:
        """See `MatrixPart.product`."""
        return self.camera, self.projector


class UniformPart(OuterPart):
    """The same weight for all pairs of N cells."""

    def __init__(self, cells: int) -> None:
        super().__init__(np.ones(cells), np.ones(cells))


@dataclass(frozen=True, eq=False)
class MatchPart:
    """``delta(partner_n - m)``: one projector cell for each camera cell; -1 is none."""

    partner: Indices

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        out = np.zeros((stop - start, self.partner.size))
        some = self.partner[start:stop]
        there = np.flatnonzero(some >= 0)
        out[there, some[there]] = 1.0
        return out

    def others(self, images: Floats) -> Floats:
        """See `MatrixPart.others`."""
        out = np.zeros(images.shape)
        there = np.flatnonzero(self._apart)
        out[:, there] = images[:, self.partner[there]]
        return out

    def entries(self, column: Indices) -> Floats:
        """See `MatrixPart.entries`."""
        return np.where((column >= 0) & (column == self.partner), 1.0, 0.0)

    def overlap(self, other: MatrixPart, weights: Floats) -> Floats:
        """See `MatrixPart.overlap`."""
        return np.where(self._apart, other.entries(self.partner) * weights[self.partner], 0.0)

    def product(self) -> None:
        """See `MatrixPart.product`: there is none."""

    @property
    def _apart(self) -> NDArray[np.bool_]:
        """Cells that have a partner other than themselves, (N,)."""
        apart: NDArray[np.bool_] = self.partner != np.arange(self.partner.size)
        return apart & (self.partner >= 0)


@dataclass(frozen=True, eq=False)
class NearPart:
    """1 where ``max(|rows|, |columns|)`` of n - m is at most `radius` cells (erratum X10)."""

    grid: Grid
    radius: int

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        r, c = np.divmod(np.arange(self.grid[0] * self.grid[1]), self.grid[1])
        down = np.abs(r[start:stop, None] - r[None, :])
        right = np.abs(c[start:stop, None] - c[None, :])
        return np.asarray(np.maximum(down, right) <= self.radius, dtype=np.float64)

    def others(self, images: Floats) -> Floats:
        """See `MatrixPart.others`."""
        lines = sum_boxes(images.reshape(-1, *self.grid), 1, self.radius)
        boxes = sum_boxes(lines, 2, self.radius)
        return np.asarray(boxes.reshape(images.shape) - images)

    def entries(self, column: Indices) -> Floats:
        """See `MatrixPart.entries`."""
        r, c = np.divmod(np.arange(column.size), self.grid[1])
        other_r, other_c = np.divmod(column, self.grid[1])
        near = np.maximum(np.abs(r - other_r), np.abs(c - other_c)) <= self.radius
        return np.where((column >= 0) & near, 1.0, 0.0)

    def overlap(self, other: MatrixPart, weights: Floats) -> Floats:
        """See `MatrixPart.overlap`."""
        if isinstance(other, NearPart):
            inner = self if self.radius <= other.radius else other
            return np.asarray(inner.others(weights[None])[0])
        return other.overlap(self, weights)

    def product(self) -> None:
        """See `MatrixPart.product`: there is none."""


@dataclass(frozen=True, eq=False)
class GainPart:
    """Another part with each row times a weight of its camera cell (N,)."""

    camera: Floats
    part: MatrixPart

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        return np.asarray(self.camera[start:stop, None] * self.part.rows(start, stop))

    def others(self, images: Floats) -> Floats:
        """See `MatrixPart.others`."""
        return np.asarray(self.camera * self.part.others(images))

    def entries(self, column: Indices) -> Floats:
        """See `MatrixPart.entries`."""
        return np.asarray(self.camera * self.part.entries(column))

    def overlap(self, other: MatrixPart, weights: Floats) -> Floats:
        """See `MatrixPart.overlap`."""
        return np.asarray(self.camera * self.part.overlap(other, weights))

    def product(self) -> tuple[Floats, Floats] | None:
        """See `MatrixPart.product`."""
        sides = self.part.product()
        return None if sides is None else (self.camera * sides[0], sides[1])


@dataclass(frozen=True, eq=False)
class IlluminatedPart:
    """Another part with each column times the light of its projector cell (N,)."""

    part: MatrixPart
    projector: Floats

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        return np.asarray(self.part.rows(start, stop) * self.projector)

    def others(self, images: Floats) -> Floats:
        """See `MatrixPart.others`."""
        return self.part.others(images * self.projector)

    def entries(self, column: Indices) -> Floats:
        """See `MatrixPart.entries`."""
        return np.asarray(self.part.entries(column) * self.projector[column])

    def overlap(self, other: MatrixPart, weights: Floats) -> Floats:
        """See `MatrixPart.overlap`."""
        return self.part.overlap(other, weights * self.projector)

    def product(self) -> tuple[Floats, Floats] | None:
        """See `MatrixPart.product`."""
        sides = self.part.product()
        return None if sides is None else (sides[0], sides[1] * self.projector)


@dataclass(frozen=True, eq=False)
class FullPart:
    """Any matrix, (N, N): everything about it is O(N^2)."""

    matrix: Floats

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        return self.matrix[start:stop]

    def others(self, images: Floats) -> Floats:
        """See `MatrixPart.others`."""
        return np.asarray(images @ self.matrix.T - images * self.matrix.diagonal())

    def entries(self, column: Indices) -> Floats:
        """See `MatrixPart.entries`."""
        return np.where(column >= 0, self.matrix[np.arange(column.size), column], 0.0)

    def overlap(self, other: MatrixPart, weights: Floats) -> Floats:
        """See `MatrixPart.overlap`."""
        cells = weights.size
        total = np.empty(cells)
        for start in range(0, cells, WANTED_BLOCK):
            stop = min(start + WANTED_BLOCK, cells)
            both = self.matrix[start:stop] * other.rows(start, stop)
            both[np.arange(stop - start), np.arange(start, stop)] = 0.0
            total[start:stop] = both @ weights
        return total

    def product(self) -> None:
        """See `MatrixPart.product`: there is none."""


@dataclass(frozen=True, eq=False)
class WantedMatrix:
    """``sum of weight * part``, each column times `light` where an illumination is given.

    With `by_direct` photos are scaled by the direct light that they keep, with `by_light` by all
    light except the direct (`pdcd.probing.deviation.weight_s`).
    """

    grid: Grid
    parts: tuple[tuple[float, MatrixPart], ...]
    light: Floats | None = None
    by_direct: bool = False
    by_light: bool = False

    @property
    def cells(self) -> int:
        """N."""
        return self.grid[0] * self.grid[1]

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1, (stop - start, N) float64."""
        total = np.zeros((stop - start, self.cells))
        for weight, part in self.parts:
            total += weight * part.rows(start, stop)
        return total if self.light is None else total * self.light

    def dense(self) -> Floats:
        """The whole matrix, (N, N): for small grids."""
        return self.rows(0, self.cells)

    def diagonal(self) -> Floats:
        """The weights of direct light, (N,)."""
        total = np.zeros(self.cells)
        for weight, part in self.parts:
            total += weight * part.entries(np.arange(self.cells))
        return total if self.light is None else total * self.light

    def entries(self, column: Indices) -> Floats:
        """Return W_nm at m = column_n, (N,); 0 where that is -1."""
        total = np.zeros(self.cells)
        for weight, part in self.parts:
            total += weight * part.entries(column)
        return total if self.light is None else total * self.light[column]

    def pairs(self, row: Indices, column: Indices) -> Floats:
        """Return W_nm of some pairs of cells n = row, m = column, (P,) each. There may be many
        pairs, but few of each row."""
        order = np.argsort(row, kind="stable")
        of = row[order]
        rank = np.arange(of.size) - np.searchsorted(of, of)
        found = np.empty(of.size)
        for one in range(int(rank.max(initial=-1)) + 1):
            these = np.flatnonzero(rank == one)
            columns = np.full(self.cells, -1)
            columns[of[these]] = column[order[these]]
            found[order[these]] = self.entries(columns)[of[these]]
        return found

    @property
    def matched(self) -> Indices | None:
        """The partners (N,) of matched cells, if these are not the cells themselves and no cell has
        several."""
        within = (part.part if isinstance(part, GainPart) else part for _, part in self.parts)
        matches = [part.partner for part in within if isinstance(part, MatchPart)]
        if len(matches) != 1 or np.array_equal(matches[0], np.arange(self.cells)):
            return None
        return matches[0]

    def others(self, images: Floats) -> Floats:
        """Return ``sum over m != n of W_nm x_rm``, (R, N), for images x (R, N)."""
        lit = images if self.light is None else images * self.light
        total = np.zeros(images.shape)
        for weight, part in self.parts:
            total += weight * part.others(lit)
        return total

    def squares(self) -> Floats:
        """Return ``sum over m != n of W_nm^2``, (N,)."""
        weights = np.ones(self.cells) if self.light is None else self.light**2
        total = np.zeros(self.cells)
        for i, (first, part) in enumerate(self.parts):
            total += first**2 * part.overlap(part, weights)
            for second, other in self.parts[:i]:
                total += 2.0 * first * second * part.overlap(other, weights)
        return total

    def products(self) -> tuple[Floats, Floats]:
        """Camera and projector sides, (r, N) each, of all parts that are products: they sum up to
        ``camera.T @ projector``. The rest is `banded`."""
        sides = [(weight, part.product()) for weight, part in self.parts]
        camera = [weight * side[0] for weight, side in sides if side is not None]
        projector = [side[1] for _, side in sides if side is not None]
        light = 1.0 if self.light is None else self.light
        shape = (len(camera), self.cells)
        return np.reshape(camera, shape), np.reshape(projector, shape) * light

    def banded(self) -> WantedMatrix:
        """The sum of all parts that are not products (`products`)."""
        kept = tuple((weight, part) for weight, part in self.parts if part.product() is None)
        return replace(self, parts=kept)

    def under(self, light: Floats | None) -> WantedMatrix:
        """The same under an illumination of the projector (N,)."""
        return replace(self, light=light)

    @property
    def uniform(self) -> tuple[float, float] | None:
        """(diagonal, other) if all entries except the diagonal are alike, else None."""
        if self.light is not None:
            return None
        diagonal = other = 0.0
        everyone = np.arange(self.cells)
        for weight, part in self.parts:
            if isinstance(part, UniformPart):
                other += weight
                diagonal += weight
            elif isinstance(part, MatchPart) and np.array_equal(part.partner, everyone):
                diagonal += weight
            else:
                return None
        return diagonal, other


def shift_cells(grid: Grid, shift: tuple[int, int]) -> Indices:
    """Partner of every cell under a shift (down, right), -1 beyond the border, (N,)."""
    r, c = np.divmod(np.arange(grid[0] * grid[1]), grid[1])
    r, c = r + shift[0], c + shift[1]
    inside = (r >= 0) & (r < grid[0]) & (c >= 0) & (c < grid[1])
    return np.where(inside, r * grid[1] + c, -1)


def sum_boxes(images: Floats, axis: int, radius: int) -> Floats:
    """Sums of all entries at most `radius` away along an axis: differences of running sums."""
    size = images.shape[axis]
    before = np.zeros([n + (a == axis) for a, n in enumerate(images.shape)])
    np.cumsum(images, axis=axis, out=before[(slice(None),) * axis + (slice(1, None),)])
    here = np.arange(size)
    last, first = np.minimum(here + radius + 1, size), np.maximum(here - radius, 0)
    return before.take(last, axis=axis) - before.take(first, axis=axis)
