"""Where code cells lie on the two panels: sub-shifts, windows and misregistration.

Positions are measured in cells of the scene's grid. Under sub-shift `l` the whole code lattice is
moved towards the origin by half a cell along columns (bit 0) and rows (bit 1). A mask cell opens
either as a whole or only in its middle (`pdcd.panels.windows`; by half and half: "quarter"
window, the paper's robust coding). Everything is a product of two axes, and within a cell each axis
falls into a few pieces ("atoms") on which nothing changes. So the optics never need more than 4
fields of the projector and 4 or 16 of the mask, however fine the panels' pixels are.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.panels.windows import MOVED, WindowKind, find_window_kind

if TYPE_CHECKING:
    from scipy.sparse import csr_array


SUB_SHIFTS = 4
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

    strip : which strip of the windows it lies in. step : as of `Overlap`.
    """

    low: float
    high: float
    strip: int
    step: int


@dataclass(frozen=True)
class Lattice:
    """Geometry of the cells of both panels over a grid of N = rows x cols scene cells.

    A *primal field* is one of the parts of each cell (1, or 2 x 2 halves) that always shows one
    projector value; a *dual field* is one of the parts of each mask cell (1, or 2 x 2 or 4 x 4
    strips) that opens under the same sub-shifts.

    offset_cells : (rows, cols)
        A scene point at x is seen through the mask at x + offset.
    """

    grid: tuple[int, int]
    window: str = "whole"
    offset_cells: tuple[float, float] = (0.0, 0.0)

    @cached_property
    def fields(self) -> int:
        """Number of primal fields, and of sub-shifts: 1 or 4."""
        return SUB_SHIFTS if self.opening.shifted else 1

    @cached_property
    def opening(self) -> WindowKind:
        """The part of a mask cell that opens."""
        return find_window_kind(self.window)

    @cached_property
    def dual_fields(self) -> int:
        """Number of dual fields: 1, 4 or 16."""
        return self.opening.kinds**2

    def dual_field(self, down: int, right: int) -> int:
        """Number of the dual field of a strip along rows and one along columns."""
        return self.opening.kinds * down + right

    def strips(self, dual_field: int) -> tuple[int, int]:
        """Strips along rows and columns of a dual field."""
        return divmod(dual_field, self.opening.kinds)

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Cells of a code pattern: one more each way when shifts must cover the borders."""
        more = 1 if self.opening.shifted else 0
        return self.grid[0] + more, self.grid[1] + more

    @cached_property
    def cells(self) -> int:
        """Scene cells, N."""
        return self.grid[0] * self.grid[1]

    @cached_property
    def lattice_cells(self) -> int:
        """Code cells, L."""
        return self.shape[0] * self.shape[1]

    @cached_property
    def continued(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """The nearest scene cell of each code cell, and how far down and right of that it lies, all
        (L,): values over the grid are continued over its far edges by it."""
        (rows, cols), (r, c) = self.grid, np.divmod(np.arange(self.lattice_cells), self.shape[1])
        inner_r, inner_c = np.minimum(r, rows - 1), np.minimum(c, cols - 1)
        return inner_r * cols + inner_c, r - inner_r, c - inner_c

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
        """What a pattern (L,) shown under a sub-shift opens on the dual fields,
        (dual_fields, L + 1)."""
        values = np.zeros((self.dual_fields, self.lattice_cells + 1))
        full, (rows, cols) = pattern.reshape(self.shape), self.shape
        moved = shift >> 1, shift & 1
        for field in range(self.dual_fields):
            strips = list(zip(self.strips(field), moved, strict=True))
            if all(self.opening.opens(strip, m) for strip, m in strips):
                down, right = (self.opening.further(strip, m) for strip, m in strips)
                table = values[field, :-1].reshape(self.shape)
                table[: rows - down, : cols - right] = full[down:, right:]
        return values

    def dual_field_uniform(self, level: float) -> Floats:
        """Dual fields of a black or fully open mask, (dual_fields, L + 1); the rest stays black."""
        values = np.full((self.dual_fields, self.lattice_cells + 1), level)
        values[:, -1] = 0.0
        return values

    @cached_property
    def overlaps(self) -> tuple[Overlap, ...]:
        """All parts of a cell with their area (they sum to 1)."""
        areas: dict[tuple[int, int, int, int], float] = {}
        for (wr, pr, dr, sr), (wc, pc, dc, sc) in itertools.product(
            _atoms(self.opening, self.offset_cells[0]), _atoms(self.opening, self.offset_cells[1])
        ):
            key = (self.dual_field(dr, dc), 2 * pr + pc, sr, sc)
            areas[key] = areas.get(key, 0.0) + wr * wc
        return tuple(
            Overlap(dual, primal, (sr, sc), self._further((sr, sc)), area)
            for (dual, primal, sr, sc), area in sorted(areas.items())
        )

    @cached_property
    def windows(self) -> tuple[Overlap, ...]:
        """All parts of a cell that lie in one strip of the mask, whatever the projector does
        there: piece by piece of `pieces`, columns fastest. Their `primal_field` is 0."""
        return tuple(
            Overlap(
                self.dual_field(down.strip, right.strip),
                0,
                (down.step, right.step),
                self._further((down.step, right.step)),
                (down.high - down.low) * (right.high - right.low),
            )
            for down, right in itertools.product(*self.pieces)
        )

    def stepped(self, field: Floats, step: tuple[int, int]) -> Floats:
        """Values of one dual field (R, L + 1), `step` cells further on, (R, rows, cols)."""
        (down, right), (rows, cols) = step, self.grid
        if 0 <= down <= self.shape[0] - rows and 0 <= right <= self.shape[1] - cols:
            full = field[:, :-1].reshape(-1, *self.shape)  # a view: most overlaps need no copy
            return full[:, down : down + rows, right : right + cols]
        return field[:, self._further(step)].reshape(-1, rows, cols)

    def _further(self, step: tuple[int, int]) -> NDArray[np.int64]:
        """Code cell, or the rest of the panel, that lies `step` from each of the scene's, (N,)."""
        r, c = np.divmod(np.arange(self.cells), self.grid[1])
        r, c = r + step[0], c + step[1]
        inside = (r >= 0) & (r < self.shape[0]) & (c >= 0) & (c < self.shape[1])
        return np.where(inside, r * self.shape[1] + c, self.lattice_cells)

    @cached_property
    def pieces(self) -> tuple[tuple[Piece, ...], tuple[Piece, ...]]:
        """Where each cell is cut by the edges of windows, along rows and columns."""
        down, right = self.offset_cells
        return _pieces(self.opening, down), _pieces(self.opening, right)

    @cached_property
    def spread(self) -> csr_array:
        """(dual_fields * (L + 1), N): mean of the dual fields over each cell, `x @ spread`."""
        from scipy.sparse import csr_array

        width = self.lattice_cells + 1
        rows = np.concatenate([o.dual_field * width + o.dual_cell for o in self.overlaps])
        columns = np.tile(np.arange(self.cells), len(self.overlaps))
        areas = np.repeat([o.area for o in self.overlaps], self.cells)
        shape = (self.dual_fields * width, self.cells)
        return csr_array((areas, (rows, columns)), shape=shape)


def _atoms(kind: WindowKind, offset: float) -> list[tuple[float, int, int, int]]:
    """Pieces of one axis of a cell: (width, primal half, strip of the mask, lattice step).

    The lattice step is how many cells further the mask's code cell lies than the scene's.
    """
    edges = {0.0, -offset % 1.0}
    if kind.shifted:
        inner = {kind.guard, 0.5 * kind.side, 1.0 - 0.5 * kind.side, 1.0 - kind.guard}
        edges = {0.0, 0.5, *((edge - offset) % 1.0 for edge in inner)}
    cuts = [*sorted(edges), 1.0]
    pieces = []
    for lo, hi in itertools.pairwise(cuts):
        if hi - lo < 1e-14:  # two edges that differ by rounding only
            continue
        at = 0.5 * (lo + hi) + offset
        if kind.shifted:
            strip = kind.strip(at % 1.0)
            own = 0.5 * (strip == MOVED)
            pieces.append((hi - lo, int(0.5 * (lo + hi) >= 0.5), strip, math.floor(at + own)))
        else:
            pieces.append((hi - lo, 0, 0, math.floor(at)))
    return pieces


def _pieces(kind: WindowKind, offset: float) -> tuple[Piece, ...]:
    """The same pieces of one axis, with those in one strip joined."""
    found: list[Piece] = []
    low = 0.0
    for width, _, strip, step in _atoms(kind, offset):
        if found and (found[-1].strip, found[-1].step) == (strip, step):
            found[-1] = Piece(found[-1].low, low + width, strip, step)
        else:
            found.append(Piece(low, low + width, strip, step))
        low += width
    return tuple(found)
