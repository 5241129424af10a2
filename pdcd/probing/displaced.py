"""For how long points of a camera cell are seen while the place that lights them is lit.

On an off-axis bench the light at the point x of a camera cell was sent from x + d, with one
displacement d for each cell (`pdcd.virtual.scene.displaced`). Windows of the mask and halves of
projector cells cut the cell into rectangles on which neither changes. Along either axis these are
cut by the same edges of windows in all cells, and by the edges of projector cells moved by -d,
which differ from cell to cell. So each pair of a window and one of the few halves that a cell can
meet is taken for all cells at once, with the area that it has in each.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.lattice import Lattice

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class _Strip:
    """Along one axis: a piece of the mask and the part of a projector cell behind it.

    length : (N,) share of each cell; half : (N,) which half of a cell (0, or 1 of two); cell : (N,)
    its row or column.
    """

    strip: int
    step: int
    length: Floats
    half: Indices
    cell: Indices


@dataclass(frozen=True, eq=False)
class Beams:
    """Direct light of displaced places on a lattice; displacement (N, 2), down and right in cells,
    NaN where there is none."""

    lattice: Lattice
    displacement: Floats

    def seen_s(self, masks: Floats, lights: Floats) -> Floats:
        """Mean time of each cell, (N,): masks (R, dual_fields, L + 1), lights (R, fields, N)."""
        lattice, count = self.lattice, lights.shape[-1]
        seen = np.zeros(count)
        width = lattice.shape[1]
        for down, right in itertools.product(*self._strips):
            area = down.length * right.length
            here = np.flatnonzero(area > 0.0)
            if not here.size:
                continue
            row, col = np.divmod(here, lattice.grid[1])
            row, col = row + down.step, col + right.step
            inside = (row >= 0) & (row < lattice.shape[0]) & (col >= 0) & (col < width)
            code = np.where(inside, row * width + col, lattice.lattice_cells)
            field = lattice.dual_field(down.strip, right.strip)
            live = np.asarray(masks[:, field].any(axis=1))  # shut under the other sub-shifts
            cell = down.cell[here] * lattice.grid[1] + right.cell[here]
            half = 2 * down.half[here] + right.half[here]
            open_ = masks[live, field][:, code]
            lit = lights[live].reshape(int(live.sum()), lights.shape[1] * count)[
                :, half * count + cell
            ]
            seen[here] += area[here] * np.einsum("rn,rn->n", open_, lit)
        return seen

    @cached_property
    def _strips(self) -> tuple[list[_Strip], list[_Strip]]:
        rows = np.divmod(np.arange(self.lattice.cells), self.lattice.grid[1])
        return self._along(0, rows[0]), self._along(1, rows[1])

    def _along(self, axis: int, place: Indices) -> list[_Strip]:
        """All strips of an axis; those beyond the grid have no length."""
        halves = 2 if self.lattice.opening.shifted else 1
        moved = self.displacement[:, axis]
        there = np.isfinite(self.displacement).all(axis=1)
        start = np.where(there, moved, 0.0) * halves
        first = np.floor(start).astype(np.int64)
        size = self.lattice.grid[axis]
        found = []
        for piece in self.lattice.pieces[axis]:
            for more in range(halves + 1):
                low = (first + more - start) / halves
                length = np.minimum(piece.high, low + 1.0 / halves) - np.maximum(piece.low, low)
                cell, half = np.divmod(first + more, halves)
                cell = cell + place
                inside = there & (cell >= 0) & (cell < size)
                length = np.where(inside & (length > 1e-14), length, 0.0)
                cell = np.clip(cell, 0, size - 1)
                found.append(_Strip(piece.strip, piece.step, length, half, cell))
        return [strip for strip in found if strip.length.any()]
