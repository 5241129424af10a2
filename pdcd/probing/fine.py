"""What the panels did to parts of cells: finer than the realised matrix, summed over its rows.

Smooth transport sees the mean of the mask over each cell, and the realised matrix contains only
that. A camera with many pixels a cell sees the mask's windows one by one, and these need not have
been open equally long: a slow panel gives the sub-shift that comes first another time than the
others, and a lost refresh hits one of them. So for every part of a cell that lies in one window a
few sums over the row of its matrix are kept, and nothing of the matrix itself.

**Direct light that reaches the mask blurred.** Relay and focus spread a point of the scene over the
mask by a Gaussian. For windows as small as that, the Gaussian determines how much direct light
misses the right one. Both panels are constant on rectangles. So the time for which a point is lit
and seen, averaged over a window's part of a cell, is a weighted sum over the rectangles of light
around it, with weights in closed form:

    integral over x in [a, b], y in [c, d] of G(x - y) = S(b-c) - S(a-c) - S(b-d) + S(a-d)

with ``S(t) = t Phi(t/s) + s phi(t/s)``, along either axis. The scene is assumed to reflect the
light around as it does in the middle.

**Off-axis light.** This is the time for which points of a camera cell are seen while the place that
lights them is lit. On an off-axis bench the light at the point x of a camera cell was sent from
x + d, with one displacement d for each cell (`pdcd.virtual.scene.displaced`). Windows of the mask
and halves of projector cells cut the cell into rectangles on which neither changes. Along either
axis these are cut by the same edges of windows in all cells, and by the edges of projector cells
moved by -d, which differ from cell to cell. So each pair of a window and one of the few halves that
a cell can meet is processed for all cells at once, with the area that it has in each.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from pdcd.arrays import Floats, Indices
from pdcd.panels.lattice import Lattice, Overlap, Piece


@dataclass(frozen=True, eq=False)
class PieceWeights:
    """Sums for every piece of the cells, (rows * P, cols * Q) float64 each, all in seconds.

    cuts : where each cell is cut along rows and columns, 0 and 1 included.
    smooth : whether all codes of neighbouring pieces are shown through windows of their own, so
        that nothing changes at the edges of cells.
    light : ``sum over m of Pi_nm``, own : ``Pi_nn``, both between the piece and whole cells.
    coaxial : mean time for which a point of the piece is both lit and seen.
    """

    cuts: tuple[tuple[float, ...], tuple[float, ...]]
    smooth: bool
    light: Floats
    own: Floats
    coaxial: Floats

    def scaled(self, factor: float) -> PieceWeights:
        """All sums times a number."""
        return PieceWeights(
            self.cuts, self.smooth, factor * self.light, factor * self.own, factor * self.coaxial
        )

    def kept(self, diagonal: float, off: float) -> Floats:
        """Weighted sums of rows: direct light by `diagonal`, other cells' by `off`."""
        return diagonal * self.coaxial + off * (self.light - self.own)


def sum_piece_weights(terms: Iterable[tuple[float, PieceWeights | None]]) -> PieceWeights | None:
    """Weighted sum; None if any term is missing, or if cells are cut in different ways."""
    total: PieceWeights | None = None
    for factor, fine in terms:
        if fine is None or (total is not None and total.cuts != fine.cuts):
            return None
        more = fine if factor == 1.0 else fine.scaled(factor)
        total = more if total is None else _plus(total, more)
    return total


def _plus(one: PieceWeights, other: PieceWeights) -> PieceWeights:
    return PieceWeights(
        one.cuts,
        one.smooth,
        one.light + other.light,
        one.own + other.own,
        one.coaxial + other.coaxial,
    )


class PieceSums:
    """Adds up the `PieceWeights` of one chunk of an exposure."""

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice
        self._pieces = lattice.pieces
        shape = len(self._pieces[0]), len(self._pieces[1]), *lattice.grid
        self._light, self._own, self._coaxial = (np.zeros(shape) for _ in range(3))
        areas = [np.array([p.high - p.low for p in axis]) for axis in self._pieces]
        self._area = np.multiply.outer(*areas)

    def add_coaxial(self, part: Overlap, time_s: Floats) -> None:
        """Mean time (rows, cols) over a part of every cell, which lies in one piece."""
        down, right = part.step
        strips = self._lattice.strips(part.dual_field)
        at = self._place(0, strips[0], down), self._place(1, strips[1], right)
        self._coaxial[at] += part.area / self._area[at] * time_s

    def add_rows(self, masks: Floats, right: Floats) -> None:
        """Rows of the realised matrix: masks (R, dual_fields, L + 1), right (R, N)."""
        lattice = self._lattice
        lights = right.reshape(-1, *lattice.grid)
        level = np.tensordot(right.sum(axis=1), masks, 1)  # (dual_fields, L + 1)
        live = np.asarray(masks.any(axis=2))  # a window is shut under the other sub-shifts
        for i, row in enumerate(self._pieces[0]):
            for j, col in enumerate(self._pieces[1]):
                field, step = lattice.dual_field(row.strip, col.strip), (row.step, col.step)
                self._light[i, j] += lattice.stepped(level[field, None], step)[0]
                seen = lattice.stepped(masks[live[:, field], field], step)
                self._own[i, j] += np.einsum("rij,rij->ij", seen, lights[live[:, field]])

    def fine(self) -> PieceWeights:
        """The sums of all that was added."""
        cuts = tuple((0.0, *(p.high for p in axis[:-1]), 1.0) for axis in self._pieces)
        return PieceWeights(
            (cuts[0], cuts[1]),
            self._lattice.opening.shifted,
            *(self._image(table) for table in (self._light, self._own, self._coaxial)),
        )

    def _image(self, table: Floats) -> Floats:
        """(P, Q, rows, cols) -> (rows * P, cols * Q)."""
        p, q, rows, cols = table.shape
        return table.transpose(2, 0, 3, 1).reshape(rows * p, cols * q)

    def _place(self, axis: int, strip: int, step: int) -> int:
        keys = [(p.strip, p.step) for p in self._pieces[axis]]
        return keys.index((strip, step))


def is_cut_by_windows(lattice: Lattice) -> bool:
    """Whether windows cut the cells at all."""
    return any(len(axis) > 1 for axis in lattice.pieces)


GAUSSIAN_REACH = 9.0
"""Standard deviations beyond which the rest of a Gaussian is below the rounding of float64."""


class Blur:
    """Blur of the light on the mask, over the cells of a lattice.

    sigma_cells : (rows, cols), standard deviation of the Gaussian in cells along either axis.
    """

    def __init__(self, lattice: Lattice, sigma_cells: tuple[float, float]) -> None:
        self._lattice, self._sigma = lattice, sigma_cells

    @cached_property
    def shares(self) -> tuple[list[Floats], list[Floats]]:
        """For each piece of a cell, along rows and columns: how much of the light of each half (or
        whole) cell falls on it, (halves * cells, cells)."""
        rows, cols = self._lattice.grid
        down, right = self._lattice.pieces
        return (
            [self._share(piece, rows, self._sigma[0]) for piece in down],
            [self._share(piece, cols, self._sigma[1]) for piece in right],
        )

    def light(self, lights: Floats) -> Iterator[Floats]:
        """Mean light on each of `Lattice.windows`, (R, rows, cols), from the projector's fields
        (R, fields, N)."""
        rows, cols = self._lattice.grid
        halves = self._halves
        count = len(lights)
        # (R, halves down, halves right, rows, cols) -> (R, halves right, cols, halves down * rows)
        whole = lights.reshape(count, halves, halves, rows, cols)
        whole = whole.transpose(0, 2, 4, 1, 3).reshape(count, halves, cols, halves * rows)
        for down in self.shares[0]:
            part = (whole @ down).reshape(count, halves * cols, rows).transpose(0, 2, 1)
            for right in self.shares[1]:
                yield part @ right

    @property
    def _halves(self) -> int:
        return 2 if self._lattice.fields > 1 else 1

    def _share(self, piece: Piece, cells: int, sigma: float) -> Floats:
        halves = self._halves
        to = np.arange(cells)
        lit = (np.arange(halves)[:, None] / halves + to).ravel()  # lower edges, half by half
        low, high = to + piece.low, to + piece.high

        def both(t: Floats) -> Floats:
            if sigma == 0.0:
                return np.maximum(t, 0.0)
            density = np.exp(-0.5 * (t / sigma) ** 2) / np.sqrt(2.0 * np.pi)
            return np.asarray(t * scipy.special.ndtr(t / sigma) + sigma * density)

        first, last = lit[:, None], lit[:, None] + 1.0 / halves
        found = both(high - first) - both(low - first) - both(high - last) + both(low - last)
        near = (high > first - GAUSSIAN_REACH * sigma) & (low < last + GAUSSIAN_REACH * sigma)
        return np.asarray(np.where(near, found, 0.0) / (piece.high - piece.low))


@dataclass(frozen=True)
class _Strip:
    """Along one axis: a piece of the mask and the part of a projector cell that lights it.

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
    """Direct light from displaced places on a lattice; displacement (N, 2), down and right in
    cells, NaN where there is none."""

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
