"""Some of the quads of each cell, from which the errors of single quads are estimated.

All quads would do, and take many times as long.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats, Indices
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.to_cells import SMEARED, find_inner_quads
from pdcd.sensor.cells import CellMap

_UNMIXED = 3
"""Distance, in quads, at which quads share no light even by a blur that nobody declared."""
SAMPLED = 4
"""Quads that are sampled along a side of the part of a cell that is seen alone."""
_APART = 3.5
"""Standard deviations of a blur from which two quads have hardly any light in common: 5 %."""


@dataclass(frozen=True, eq=False)
class QuadSample:
    """Some quads of each cell that see nothing else.

    rows, columns : of the frame, of which the quads `picked` (R, C) count. cell : (Q,), the cell
    that each of these sees. pairs : (2, M), numbers of two in the same cell, far enough apart that
    no blur mixes them. grid : (rows, cols) of cells.
    """

    rows: slice
    columns: Indices
    picked: Bools
    cell: Indices
    pairs: Indices
    grid: tuple[int, int]

    def share_told(self) -> float:
        """Share of the cells in which two quads or more were picked."""
        return float(np.mean(np.bincount(self.cell, minlength=self.grid[0] * self.grid[1]) > 1))

    def take(self, read: Callable[[slice], NDArray[np.floating]]) -> Floats:
        """Values of these quads, (Q, C); `read` gives those of some rows of a frame."""
        values = read(self.rows)
        row, column = self._places
        flat = values.reshape(-1, values.shape[2])
        return np.asarray(flat.take(row * values.shape[1] + column, axis=0), dtype=np.float64)

    @functools.cached_property
    def _places(self) -> tuple[Indices, Indices]:
        row, column = np.nonzero(self.picked)
        return row, self.columns[column]

    def sums(self, values: Floats, side: int = 1) -> Floats:
        """Sums of values (Q, C) over each cell and those around it, a square of `side`: (N, C)."""
        return self.of_pairs(values, self.cell, side)

    def of_pairs(self, values: Floats, cell: Indices, side: int) -> Floats:
        """The same of values (M, C) that belong to these cells (M,)."""
        size = self.grid[0] * self.grid[1]
        sums = np.zeros((size, values.shape[1]))
        for channel, one in enumerate(values.T):
            sums[:, channel] = np.bincount(cell, one, size)
        return sums if side == 1 else side**2 * self.around(sums, side)

    def around(self, values: Floats, side: int) -> Floats:
        """Means of values of cells (N, C) over squares of `side` around them, 0 beyond the grid."""
        table = values.reshape(*self.grid, -1)
        mean = scipy.ndimage.uniform_filter(table, (side, side, 1), mode="constant")
        return np.asarray(mean.reshape(values.shape))


def sample_quads(
    shots: Sequence[ExposedShot], cells: CellMap, *, within: bool = False, along: int = SAMPLED
) -> QuadSample:
    """Some quads of each cell that no shot saturates, for
    `pdcd.pictures.sigma.estimate_quad_shares` and, well `within` cells that are fine enough, for
    `pdcd.pictures.beside.estimate_quad_paths`. along : how many, along a side of the part of a cell
    that is seen alone."""
    side = cells.quad_cells**-0.5 if cells.quad_cells else 1.0
    step = max(1, int((side - 2.0 * SMEARED * cells.blur_quads) / along))
    apart = max(int(np.clip(side / 4.0, 1.0, _UNMIXED)), int(np.ceil(_APART * cells.blur_quads)))
    rows = slice(step // 2, cells.frame[0], step)
    columns = np.arange(cells.frame[1])
    columns = columns[(columns % step == 0) | within & ((columns - apart) % step == 0)]
    whole = cells.known & cells.single
    if within and (inner := whole & find_inner_quads(cells)).any():
        whole = inner
    known = whole[rows][:, columns]
    for shot in shots:
        known &= ~shot.saturated[rows][:, columns]
    y = np.arange(cells.frame[0])[rows] + 0.5
    places = cells.filled.to_field(np.stack(np.meshgrid(columns + 0.5, y), axis=-1)[known])
    cell = np.zeros(len(places), dtype=np.int64)
    for place, count in zip(places.T[::-1], cells.grid, strict=True):
        cell = cell * count + np.clip(place * count, 0, count - 1).astype(np.int64)
    number = np.full(known.shape, -1)
    number[known] = np.arange(cell.size)
    other = np.searchsorted(columns, columns + apart) % columns.size
    other = np.where(columns[other] == columns + apart, other, 0)
    first, second = number, np.where(other > 0, number[:, other], -1)
    both = (first >= 0) & (second >= 0)
    pairs = np.stack([first[both], second[both]])
    pairs = pairs[:, cell[pairs[0]] == cell[pairs[1]]]
    return QuadSample(rows, columns, known, cell, pairs, cells.grid)
