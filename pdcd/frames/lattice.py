"""Where code cells lie on the two panels: sub-shifts, windows and misregistration.

Positions are measured in cells of the scene's grid. Under sub-shift `l` the whole code lattice is
moved towards the origin by half a cell along columns (bit 0) and rows (bit 1); a mask cell opens
either as a whole or only in its central half by half ("quarter" window, the paper's robust
coding). Everything is a product of two axes, and within a cell each axis falls into a few pieces
("atoms") on which nothing changes. So the optics never need more than 4 fields per panel, however
fine the panels' pixels are.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Floats = NDArray[np.float64]

SHIFTS = 4
"""Sub-shifts of one code in quarter-window mode."""


@dataclass(frozen=True)
class Overlap:
    """A part of every cell on which one mask field and one projector field meet.

    `step` is how many cells (rows, cols) the mask's code cell lies further than the scene's.
    `dual_cell` (N,) int64 is the pixel of the mask field seen there; the last one, L, is the rest
    of the panel, where the code's cells end.
    """

    dual_field: int
    primal_field: int
    step: tuple[int, int]
    dual_cell: NDArray[np.int64]
    area: float


@dataclass(frozen=True)
class Piece:
    """A part of every cell along one axis, from `low` to `high`, that lies in one window.

    shift : whether that window opens under the shifted code. step : as of `Overlap`.
    """

    low: float
    high: float
    shift: int
    step: int


@dataclass(frozen=True)
class Lattice:
    """Geometry of the cells of both panels over a grid of N = rows x cols scene cells.

    A *primal field* is one of the parts of each cell (1, or 2 x 2 halves) that always shows one
    projector value; a *dual field* is one set of windows (1, or one for each sub-shift).

    offset_cells : (rows, cols)
        A scene point at x is seen through the mask at x + offset.
    """

    grid: tuple[int, int]
    window: str = "whole"
    offset_cells: tuple[float, float] = (0.0, 0.0)

    @cached_property
    def fields(self) -> int:
        """Number of primal fields, and of dual fields: 1 or 4."""
        return SHIFTS if self.window == "quarter" else 1

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Cells of a code pattern: one more each way when shifts must cover the borders."""
        more = 1 if self.window == "quarter" else 0
        return self.grid[0] + more, self.grid[1] + more

    @cached_property
    def cells(self) -> int:
        """Scene cells, N."""
        return self.grid[0] * self.grid[1]

    @cached_property
    def lattice_cells(self) -> int:
        """Code cells, L."""
        return self.shape[0] * self.shape[1]

    def primal_field_values(self, pattern: Floats, shift: int) -> Floats:
        """What a pattern (L,) shown under a sub-shift puts on the primal fields, (fields, N)."""
        if self.fields == 1:
            return pattern.reshape(1, -1)
        full, (rows, cols) = pattern.reshape(self.shape), self.grid
        values = np.empty((self.fields, rows, cols))
        for f in range(self.fields):
            down = (f >> 1) & (shift >> 1)  # the lower half of a cell sees the next code cell
            right = (f & 1) & (shift & 1)
            values[f] = full[down : down + rows, right : right + cols]
        return values.reshape(self.fields, -1)

    def dual_field_values(self, pattern: Floats, shift: int) -> Floats:
        """What a pattern (L,) shown under a sub-shift opens on the dual fields, (fields, L + 1)."""
        values = np.zeros((self.fields, self.lattice_cells + 1))
        values[shift, :-1] = pattern
        return values

    def dual_field_uniform(self, level: float) -> Floats:
        """Dual fields of a black or fully open mask, (fields, L + 1); the rest stays black."""
        values = np.full((self.fields, self.lattice_cells + 1), level)
        values[:, -1] = 0.0
        return values

    @cached_property
    def overlaps(self) -> tuple[Overlap, ...]:
        """All parts of a cell with their area (they sum to 1)."""
        areas: dict[tuple[int, int, int, int], float] = {}
        for (wr, pr, dr, sr), (wc, pc, dc, sc) in itertools.product(
            _atoms(self.window, self.offset_cells[0]), _atoms(self.window, self.offset_cells[1])
        ):
            key = (2 * dr + dc, 2 * pr + pc, sr, sc)
            areas[key] = areas.get(key, 0.0) + wr * wc
        return tuple(
            Overlap(dual, primal, (sr, sc), self._further((sr, sc)), area)
            for (dual, primal, sr, sc), area in sorted(areas.items())
        )

    @cached_property
    def windows(self) -> tuple[Overlap, ...]:
        """All parts of a cell that lie in one window of the mask, whatever the projector does
        there: piece by piece of `pieces`, columns fastest. Their `primal_field` is 0."""
        return tuple(
            Overlap(
                2 * down.shift + right.shift,
                0,
                (down.step, right.step),
                self._further((down.step, right.step)),
                (down.high - down.low) * (right.high - right.low),
            )
            for down, right in itertools.product(*self.pieces)
        )

    def seen(self, field: Floats, overlap: Overlap) -> Floats:
        """Values of one dual field (R, L + 1) over the scene's cells, (R, rows, cols)."""
        return self.stepped(field, overlap.step)

    def stepped(self, field: Floats, step: tuple[int, int]) -> Floats:
        """Values of one dual field (R, L + 1) so many cells further on, (R, rows, cols)."""
        (down, right), (rows, cols) = step, self.grid
        if 0 <= down <= self.shape[0] - rows and 0 <= right <= self.shape[1] - cols:
            full = field[:, :-1].reshape(-1, *self.shape)  # a view: most overlaps need no copy
            return full[:, down : down + rows, right : right + cols]
        return field[:, self._further(step)].reshape(-1, rows, cols)

    def _further(self, step: tuple[int, int]) -> NDArray[np.int64]:
        """Code cell, or the rest of the panel, that lies `step` off each of the scene's, (N,)."""
        r, c = np.divmod(np.arange(self.cells), self.grid[1])
        r, c = r + step[0], c + step[1]
        inside = (r >= 0) & (r < self.shape[0]) & (c >= 0) & (c < self.shape[1])
        return np.where(inside, r * self.shape[1] + c, self.lattice_cells)

    @cached_property
    def pieces(self) -> tuple[tuple[Piece, ...], tuple[Piece, ...]]:
        """Where each cell is cut by the edges of windows, along rows and columns."""
        down, right = self.offset_cells
        return _pieces(self.window, down), _pieces(self.window, right)

    @cached_property
    def spread(self) -> sparse.csr_array:
        """(fields * (L + 1), N): mean of the dual fields over each scene cell, `x @ spread`."""
        width = self.lattice_cells + 1
        rows = np.concatenate([o.dual_field * width + o.dual_cell for o in self.overlaps])
        columns = np.tile(np.arange(self.cells), len(self.overlaps))
        areas = np.repeat([o.area for o in self.overlaps], self.cells)
        shape = (self.fields * width, self.cells)
        return sparse.csr_array((areas, (rows, columns)), shape=shape)


def _atoms(window: str, offset: float) -> list[tuple[float, int, int, int]]:
    """Pieces of one axis of a cell: (width, primal half, dual shift bit, lattice step).

    The lattice step is how many cells further the mask's code cell lies than the scene's.
    """
    edges = {0.0, -offset % 1.0}
    if window == "quarter":
        edges = {0.0, 0.5, (0.25 - offset) % 1.0, (0.75 - offset) % 1.0}
    cuts = [*sorted(edges), 1.0]
    pieces = []
    for lo, hi in itertools.pairwise(cuts):
        if hi - lo < 1e-14:  # two edges that differ by rounding only
            continue
        mid = 0.5 * (lo + hi)
        if window == "quarter":
            # Exactly one of the two shifts opens its window over any point.
            bit = 0 if 0.25 <= (mid + offset) % 1.0 < 0.75 else 1
            pieces.append((hi - lo, int(mid >= 0.5), bit, math.floor(mid + offset + 0.5 * bit)))
        else:
            pieces.append((hi - lo, 0, 0, math.floor(mid + offset)))
    return pieces


def _pieces(window: str, offset: float) -> tuple[Piece, ...]:
    """The same pieces of one axis, those in one window put together."""
    found: list[Piece] = []
    low = 0.0
    for width, _, shift, step in _atoms(window, offset):
        if found and (found[-1].shift, found[-1].step) == (shift, step):
            found[-1] = Piece(found[-1].low, low + width, shift, step)
        else:
            found.append(Piece(low, low + width, shift, step))
        low += width
    return tuple(found)
