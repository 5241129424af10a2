"""Wanted weights along epipolar lines: rows of cells of a rectified rig."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.probing.wanted import Floats, Grid, Indices, Near, Part


@dataclass(frozen=True, eq=False)
class SameRow:
    """1 where camera cell and projector cell lie in one row, on one epipolar line."""

    grid: Grid

    def rows(self, start: int, stop: int) -> Floats:
        """See `Part.rows`."""
        row = np.arange(self.grid[0] * self.grid[1]) // self.grid[1]
        return np.asarray(row[start:stop, None] == row[None, :], dtype=np.float64)

    def others(self, images: Floats) -> Floats:
        """See `Part.others`."""
        lines = images.reshape(-1, *self.grid)
        return np.asarray((lines.sum(axis=2, keepdims=True) - lines).reshape(images.shape))

    def entries(self, column: Indices) -> Floats:
        """See `Part.entries`."""
        row = np.arange(column.size) // self.grid[1]
        return np.where((column >= 0) & (column // self.grid[1] == row), 1.0, 0.0)

    def overlap(self, other: Part, weights: Floats) -> Floats:
        """See `Part.overlap`."""
        if isinstance(other, SameRow):
            return np.asarray(self.others(weights[None])[0])
        if isinstance(other, Near):
            lines = _sums(weights.reshape(self.grid), other.radius)
            return np.asarray(lines.ravel() - weights)
        return other.overlap(self, weights)

    def product(self) -> None:
        """See `Part.product`: it is none."""


def _sums(lines: Floats, radius: int) -> Floats:
    """Sums over all cells of a row at most `radius` away, (rows, cols)."""
    cols = lines.shape[1]
    running = np.concatenate([np.zeros((len(lines), 1)), np.cumsum(lines, axis=1)], axis=1)
    here = np.arange(cols)
    last, first = np.minimum(here + radius + 1, cols), np.maximum(here - radius, 0)
    return np.asarray(running[:, last] - running[:, first])
