"""What the panels did to parts of cells: finer than the realised matrix, summed up over its rows.

Smooth transport sees the mean of the mask over each cell, and that is all that the realised matrix
knows. A camera with many pixels a cell sees the mask's windows one by one, and these need not have
been open equally long: a slow panel gives the sub-shift that comes first another time than the
others, and a lost refresh hits one of them. So for every part of a cell that lies in one window a
few sums over the row of its matrix are kept, and nothing of the matrix itself.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.lattice import Lattice, Overlap

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Fine:
    """Of every piece of the cells, (rows * P, cols * Q) float64 each, all in seconds.

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

    def scaled(self, factor: float) -> Fine:
        """The same times a number."""
        return Fine(
            self.cuts, self.smooth, factor * self.light, factor * self.own, factor * self.coaxial
        )

    def kept(self, diagonal: float, off: float) -> Floats:
        """Weighted sums of rows: direct light by `diagonal`, other cells' by `off`."""
        return diagonal * self.coaxial + off * (self.light - self.own)


def summed(terms: Iterable[tuple[float, Fine | None]]) -> Fine | None:
    """Weighted sum; None where any is missing, or where cells are cut in different ways."""
    total: Fine | None = None
    for factor, fine in terms:
        if fine is None or (total is not None and total.cuts != fine.cuts):
            return None
        more = fine if factor == 1.0 else fine.scaled(factor)
        total = more if total is None else _plus(total, more)
    return total


def _plus(one: Fine, other: Fine) -> Fine:
    return Fine(
        one.cuts,
        one.smooth,
        one.light + other.light,
        one.own + other.own,
        one.coaxial + other.coaxial,
    )


class FineSums:
    """Gathers `Fine` of one chunk of an exposure."""

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

    def fine(self) -> Fine:
        """All that was added."""
        cuts = tuple((0.0, *(p.high for p in axis[:-1]), 1.0) for axis in self._pieces)
        return Fine(
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


def cut_by_windows(lattice: Lattice) -> bool:
    """Whether windows cut the cells at all."""
    return any(len(axis) > 1 for axis in lattice.pieces)
