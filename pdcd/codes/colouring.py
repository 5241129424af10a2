"""Colouring of a lattice: cells of one colour keep apart, and their signs cancel in every region.

Cells of one colour share a code, so the light that travels between two of them is counted with
weight 0 (same sign) or 2 (opposite signs) where 1 is wanted. Indirect light between cells falls
off with distance and varies smoothly over far cells. Hence two rules: the colour of a cell is the
one whose cells are farthest off, and its sign opposes the signs that this colour has around it.
Where single paths are known, a third rule adds them to what the distance alone would fear.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

LINKED = 60.0
"""Mean sum of squared links of a cell: ten times the sum of 1/d^4 over all cells around it. So what
is known goes before what distance alone would fear, but if it is wrong it does not undo all of
it."""
REACH = 64
"""Cells, up and down, left and right, over which a cell looks around at the least."""
RINGS = 4.0
"""Distances between cells of one colour, about the root of the number of colours, over which a cell
looks around at the least. All colours are there that often; beyond, they crowd much alike, as the
sum of 1/d^4 has little left, and their signs cancel in every region that has cancelled before."""
_SPARE_BINS = 64
"""Enough that sums of cells without a colour do not wait for each other."""
_ROUNDING = 1e-9
"""Cells ahead of the front by no more are looked at too; they have no colour yet."""


def colour_lattice(
    lattice: tuple[int, int], colours: int, rng: np.random.Generator, links: Any = None
) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """Colour the cells of a lattice, one after the other along a front.

    The front sweeps in a random direction, which packs the colours more regularly than a random
    order of cells does, yet never as regularly as a lattice colouring, in which one mirror in the
    scene can meet the same colour over a whole region. Cells with known links go first, the
    strongest linked before all, while there is still choice. Each cell takes the colour of least
    crowding sum(1/d^4) over the cells d away that bear it, then the sign against the sum(sign/d).
    It looks `REACH` cells around, or `RINGS`, so that the time is linear in the cells.

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
    cells = lattice[0] * lattice[1]
    known = _Links(links, cells)
    order, along = _front(lattice, rng)
    order = order[np.argsort(-known.weight[order], kind="stable")]
    sign = rng.choice(np.array([-1, 1], dtype=np.int8), cells)
    # No colour yet: bins of their own, that are never chosen. They are several, because adding to
    # one bin again and again waits each time for the sum before.
    start = colours + np.arange(cells) % _SPARE_BINS
    front = _Front(lattice, colours, start, known, along)
    for number, cell in enumerate(order[:colours].tolist()):
        front.colour(cell, number, sign[cell])
    for cell in order[colours:].tolist():
        best, around = front.look(cell)
        if around != 0.0:
            sign[cell] = -1 if around > 0.0 else 1
        front.colour(cell, best, sign[cell])
    return front.colours(), sign


class _Front:
    """What has been coloured so far, and a look at it from one cell.

    Cells are numbered in a table with a border as wide as a look reaches, so that every look is
    one and the same list of steps. `bins` is more than any colour; a cell without one has a number
    from `colours` on.
    """

    def __init__(
        self,
        lattice: tuple[int, int],
        colours: int,
        start: NDArray[np.int64],
        known: _Links,
        along: tuple[float, float],
    ) -> None:
        rows, cols = lattice
        self._known, self._colours, self._bins = known, colours, colours + _SPARE_BINS
        reach = _reach(colours)
        above, aside = min(reach, rows - 1), min(reach, cols - 1)
        table = colours + np.arange((rows + 2 * above) * (cols + 2 * aside)) % _SPARE_BINS
        width = cols + 2 * aside
        row, col = np.divmod(np.arange(rows * cols), cols)
        self._number = (row + above) * width + col + aside
        self._table, self._placed = table, np.zeros(table.size)
        table[self._number] = start
        self._places = self._number.tolist()
        down, right = _steps((above, aside), None if known.weight.any() else along)
        self._steps = down * width + right
        self._first = int(self._steps[0]) if self._steps.size else 0
        self._steps -= self._first
        squared = (down**2 + right**2).astype(np.float64)
        self._crowding, self._pull = 1.0 / squared**2, 1.0 / np.sqrt(squared)

    def look(self, cell: int) -> tuple[int, float]:
        """The colour that crowds a cell least, and the sum of its signs around it."""
        first = self._places[cell] + self._first
        # All steps lie in the table; to be told so saves the time of looking.
        colours = self._table[first:].take(self._steps, mode="clip")
        crowd = np.bincount(colours, self._crowding, self._bins)
        other, strength = self._known.of(cell)
        if other.size:
            linked = self._number[other]
            crowd += np.bincount(self._table[linked], strength**2, self._bins)
        best = int(crowd[: self._colours].argmin())
        same = (colours == best).nonzero()[0]
        signs = float(self._placed[first:].take(self._steps.take(same)) @ self._pull.take(same))
        if other.size:
            signs += float((self._table[linked] == best) * self._placed[linked] @ strength)
        return best, signs

    def colour(self, cell: int, colour: int, sign: int) -> None:
        """Give a cell its colour and sign."""
        place = self._places[cell]
        self._table[place], self._placed[place] = colour, sign

    def colours(self) -> NDArray[np.int64]:
        """Of all cells, (L,)."""
        return np.asarray(self._table[self._number], dtype=np.int64)


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
        0 .. phases - 1: the one with the least sum(1/d) over cells of the same colour and phase
        that the front has passed since it was as far off as `colour_lattice` looks.
    """
    phase = rng.integers(phases, size=colour.size)
    order, (along_row, along_col) = _front(lattice, rng)
    reach = _reach(int(colour.max()) + 1) + 1  # one more than that, for rounding
    strip = reach * (abs(along_row) + abs(along_col))
    order = order[np.argsort(colour[order], kind="stable")]
    for same in np.split(order, np.flatnonzero(np.diff(colour[order])) + 1):
        row, col = np.divmod(same, lattice[1])
        passed = along_row * row + along_col * col
        since = np.searchsorted(passed, passed - strip)
        for number, (cell, start) in enumerate(zip(same.tolist(), since.tolist(), strict=True)):
            near = slice(start, number)
            pull = 1.0 / np.hypot(row[near] - row[number], col[near] - col[number])
            around = np.bincount(phase[same[near]], pull, phases)
            mine = phase[cell]
            phase[cell] = (mine + np.argmin(np.roll(around, -mine))) % phases
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


def _front(
    lattice: tuple[int, int], rng: np.random.Generator
) -> tuple[NDArray[np.int64], tuple[float, float]]:
    """Cells in the order in which a straight front of random direction passes them: (L,) int64.

    Also that direction, (down, right), in no unit.
    """
    row, col = np.indices(lattice)
    along_row, along_col = rng.random(2) - 0.5
    order = np.argsort((along_row * row + along_col * col).ravel(), kind="stable")
    return order, (float(along_row), float(along_col))


def _steps(
    reach: tuple[int, int], along: tuple[float, float] | None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows down and columns right to all cells around that can have a colour already, row by row.

    A front that moves in the direction `along` has not passed what lies ahead of it; without one,
    cells are coloured anywhere.
    """
    down, right = np.indices((2 * reach[0] + 1, 2 * reach[1] + 1)) - np.reshape(reach, (2, 1, 1))
    passed = (down != 0) | (right != 0)
    if along is not None:
        passed &= along[0] * down + along[1] * right < _ROUNDING
    return down[passed], right[passed]


def _reach(colours: int) -> int:
    """How many cells away others are looked at, up and down, left and right."""
    return max(REACH, math.ceil(RINGS * math.sqrt(colours)))
