"""Wanted probing matrices, as sums of parts that are never stored whole.

Every row of Tables 1 and 2 of the paper is such a sum. n is a camera cell, m a projector cell, both
row-major over a grid of N cells. One convention for shifts everywhere: a shift w = (down, right)
pairs camera cell n with projector cell m = n + w (Table 1, row 4); cells whose partner lies beyond
the border have none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Grid = tuple[int, int]


class Part(Protocol):
    """One part of a wanted matrix."""

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1, (stop - start, N)."""
        ...


@dataclass(frozen=True, eq=False)
class Uniform:
    """The same weight for all pairs of N cells."""

    cells: int

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        return np.ones((stop - start, self.cells))


@dataclass(frozen=True, eq=False)
class Match:
    """``delta(partner_n - m)``: one projector cell for each camera cell; -1 is none."""

    partner: Indices

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        out = np.zeros((stop - start, self.partner.size))
        some = self.partner[start:stop]
        there = np.flatnonzero(some >= 0)
        out[there, some[there]] = 1.0
        return out


@dataclass(frozen=True, eq=False)
class Near:
    """1 where ``max(|rows|, |columns|)`` of n - m is at most `radius` cells (erratum X10)."""

    grid: Grid
    radius: int

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        r, c = np.divmod(np.arange(self.grid[0] * self.grid[1]), self.grid[1])
        down = np.abs(r[start:stop, None] - r[None, :])
        right = np.abs(c[start:stop, None] - c[None, :])
        return np.asarray(np.maximum(down, right) <= self.radius, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Outer:
    """``camera_n * projector_m``: a region, an illumination, a product of both."""

    camera: Floats
    projector: Floats

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        return np.outer(self.camera[start:stop], self.projector)


@dataclass(frozen=True, eq=False)
class Full:
    """Any matrix, (N, N)."""

    matrix: Floats

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        return self.matrix[start:stop]


@dataclass(frozen=True, eq=False)
class Wanted:
    """``sum of weight * part``, each column times `light` where an illumination is given.

    With `by_direct` photos are scaled by the direct light they keep
    (`pdcd.probing.deviation.weight_s`).
    """

    grid: Grid
    parts: tuple[tuple[float, Part], ...]
    light: Floats | None = None
    by_direct: bool = False

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

    def under(self, light: Floats | None) -> Wanted:
        """The same under an illumination of the projector (N,)."""
        return Wanted(self.grid, self.parts, light, self.by_direct)

    @property
    def uniform(self) -> tuple[float, float] | None:
        """(diagonal, other) when all entries are alike but for the diagonal, else None."""
        if self.light is not None:
            return None
        diagonal = other = 0.0
        everyone = np.arange(self.cells)
        for weight, part in self.parts:
            if isinstance(part, Uniform):
                other += weight
                diagonal += weight
            elif isinstance(part, Match) and np.array_equal(part.partner, everyone):
                diagonal += weight
            else:
                return None
        return diagonal, other


def shifted(grid: Grid, shift: tuple[int, int]) -> Indices:
    """Partner of every cell under a shift (down, right), -1 beyond the border, (N,)."""
    r, c = np.divmod(np.arange(grid[0] * grid[1]), grid[1])
    r, c = r + shift[0], c + shift[1]
    inside = (r >= 0) & (r < grid[0]) & (c >= 0) & (c < grid[1])
    return np.where(inside, r * grid[1] + c, -1)
