"""Colouring of a lattice: cells of one colour keep apart, and their signs cancel in every region.

Cells of one colour share a code, so the light that travels between two of them is counted with
weight 0 (same sign) or 2 (opposite signs) where 1 is wanted. Indirect light between cells falls
off with distance and varies smoothly over far cells. Hence two rules: the colour of a cell is the
one whose cells are farthest off, and its sign opposes the signs that this colour has around it.
Where single paths are known, a third rule adds them to what the distance alone would fear.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

LINKED = 60.0
"""Mean sum of squared links of a cell: ten times the sum of 1/d^4 over all cells around it. So what
is known goes before what distance alone would fear, but if it is wrong it does not undo all of
it."""
_SPARE_BINS = 64
"""Enough that sums of cells without a colour do not wait for each other."""


def colour_lattice(
    lattice: tuple[int, int], colours: int, rng: np.random.Generator, links: Any = None
) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """Colour the cells of a lattice, one after the other along a front.

    The front sweeps in a random direction, which packs the colours more regularly than a random
    order of cells does, yet never as regularly as a lattice colouring, in which one mirror in the
    scene can meet the same colour over a whole region. Cells with known links go first, the
    strongest linked before all, while there is still choice. Each cell takes the colour of least
    crowding sum(1/d^4) over the cells d away that bear it, then the sign against the sum(sign/d).

    Parameters
    ----------
    lattice : (rows, cols)
        Cells, numbered row by row.
    colours : int
        How many colours there are; with at least as many as cells each cell has its own.
    rng : Generator
        Source of the direction and of signs that nothing else decides.
    links : sparse array (L, L), symmetric, >= 0, empty diagonal, or None
        Known strengths of light paths between cells, in any unit. A link crowds by its squared
        strength; those of a cell do so ten times as much, on average, as all cells around it do
        by their distance.

    Returns
    -------
    colour : (L,) int64
        0 .. colours - 1, and no colour is left out below the largest one used.
    sign : (L,) int8
        +1 or -1.
    """
    rows, cols = lattice
    cells = rows * cols
    known = _Links(links, cells)
    order = _front(lattice, rng)
    order = order[np.argsort(-known.weight[order], kind="stable")]
    sign = rng.choice(np.array([-1, 1], dtype=np.int8), cells)
    # No colour yet: bins of their own, that are never chosen. They are several, because adding to
    # one bin again and again waits each time for the sum before.
    bins = colours + _SPARE_BINS
    colour = colours + np.arange(cells) % _SPARE_BINS
    colour[order[:colours]] = np.arange(min(colours, cells))

    crowding, pull = _kernels(lattice)
    placed_sign = np.zeros(cells)
    placed_sign[order[:colours]] = sign[order[:colours]]
    for cell in order[colours:]:
        row, col = divmod(int(cell), cols)
        window = np.s_[rows - 1 - row : 2 * rows - 1 - row, cols - 1 - col : 2 * cols - 1 - col]
        crowd = np.bincount(colour, crowding[window].ravel(), bins)
        other, strength = known.of(cell)
        if other.size:
            crowd += np.bincount(colour[other], strength**2, bins)
        best = int(np.argmin(crowd[:colours]))
        same = np.flatnonzero(colour == best)
        around = float(placed_sign[same] @ pull[window][np.divmod(same, cols)])
        if other.size:
            around += float((colour[other] == best) * placed_sign[other] @ strength)
        if around != 0.0:
            sign[cell] = -1 if around > 0.0 else 1
        colour[cell] = best
        placed_sign[cell] = sign[cell]
    return colour, sign


def phase_lattice(
    lattice: tuple[int, int], colour: NDArray[np.int64], phases: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Give each cell one of some phases, which among cells of a colour alternate in every region.

    Parameters
    ----------
    lattice : (rows, cols)
    colour : (L,) int64
        From `colour_lattice`.
    phases : int
        How many there are; cells of one colour are to have different ones, above all near cells.
    rng : Generator
        Source of the order of cells, and of phases that nothing else decides.

    Returns
    -------
    (L,) int64
        0 .. phases - 1: the one with the least sum(1/d) over cells of the same colour and phase.
    """
    cols = lattice[1]
    placed: list[list[int]] = [[] for _ in range(int(colour.max()) + 1)]
    phase = rng.integers(phases, size=colour.size)
    for cell in _front(lattice, rng):
        same = np.array(placed[colour[cell]], dtype=np.int64)
        row, col = np.divmod(same, cols)
        pull = 1.0 / np.hypot(row - cell // cols, col - cell % cols)
        around = np.bincount(phase[same], pull, phases)
        first = phase[cell]
        phase[cell] = (first + np.argmin(np.roll(around, -first))) % phases
        placed[colour[cell]].append(int(cell))
    return phase


class _Links:
    """Links of one cell at a time, scaled to a mean sum of squares of `LINKED` for each cell."""

    def __init__(self, links: Any, cells: int) -> None:
        matrix = scipy.sparse.csr_array((cells, cells) if links is None else links, dtype=float)
        total = float(np.sum(matrix.data**2))
        scale = np.sqrt(total / (LINKED * cells)) if total > 0.0 else 1.0
        self._start, self._other = matrix.indptr, matrix.indices
        self._strength = matrix.data / scale
        self.weight: NDArray[np.float64] = matrix.power(2).sum(axis=1)

    def of(self, cell: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Cells linked to `cell`, and how strongly: (n,) each."""
        span = slice(self._start[cell], self._start[cell + 1])
        return self._other[span], self._strength[span]


def _front(lattice: tuple[int, int], rng: np.random.Generator) -> NDArray[np.int64]:
    """Cells in the order in which a straight front of random direction passes them: (L,) int64."""
    row, col = np.indices(lattice)
    along_row, along_col = rng.random(2) - 0.5
    return np.argsort((along_row * row + along_col * col).ravel(), kind="stable")


def _kernels(lattice: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """1/d^4 and 1/d of every offset between two cells, (2 rows - 1, 2 cols - 1) float64 each.

    The centre (offset 0) holds 0: a cell does not push itself.
    """
    row = np.arange(1 - lattice[0], lattice[0], dtype=np.float64)
    col = np.arange(1 - lattice[1], lattice[1], dtype=np.float64)
    squared = row[:, None] ** 2 + col**2
    squared[lattice[0] - 1, lattice[1] - 1] = np.inf
    return 1.0 / squared**2, 1.0 / np.sqrt(squared)
