"""Colouring of a lattice: cells of one colour keep apart, and their signs cancel in every region.

Cells of one colour share a code, so the light that travels between two of them is counted with
weight 0 (same sign) or 2 (opposite signs) where 1 is wanted. Indirect light between cells falls
off with distance and varies smoothly over far cells. Hence two rules: the colour of a cell is the
one whose cells are farthest away, and its sign opposes the signs that this colour has around it.
Where single paths are known, a third rule adds them to what is expected from distance alone.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

LINKED = 60.0
"""Mean sum of squared links of a cell: ten times the sum of 1/d^4 over all cells around it. So
known links have precedence over distance, but if they are wrong they do not undo all of it."""
LOOSE = 2.0
"""Largest random factor on the weight of a cell's links, where colourings are to differ: cells then
come in another order, but strong links still before weak ones."""
COLOUR_REACH = 64
"""Least distance in cells, up and down, left and right, to which a cell considers others."""
RINGS = 4.0
"""The same in distances between cells of one colour, about the root of the number of colours. Each
colour is within reach so often. Beyond, all crowd about equally, as the sum of 1/d^4 has little
left, and their signs cancel in every region that has cancelled before."""
_SPARE_BINS = 64
"""Enough bins that sums of cells without a colour do not wait for each other."""


def colour_lattice(
    lattice: tuple[int, int],
    colours: int,
    rng: np.random.Generator,
    links: Any = None,
    *,
    apart: bool = False,
) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """Colour the cells of a lattice, one after the other along a front.

    The front sweeps in a random direction, which packs the colours more regularly than a random
    order of cells does, yet never as regularly as a lattice colouring, in which one mirror in the
    scene can meet the same colour over a whole region. Cells with known links go first, the
    strongest linked before all, while there is still choice. Each cell takes the colour of least
    crowding sum(1/d^4) over the cells d away that bear it, then the sign against the sum(sign/d).
    It considers cells within `COLOUR_REACH`, or `RINGS`, so that the time is linear in the cells.

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
        strength; the links of a cell do so ten times as much, on average, as all cells around it do
        by their distance.
    apart : one of several colourings that are to share colours between different cells. Where all
        cells have links, these alone determine the order of the cells, and with it the same
        colouring every time; so the order is partly randomised.

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
    loosened = LOOSE ** rng.uniform(-1.0, 1.0, cells) if apart else 1.0
    order = order[np.argsort(-(known.weight * loosened)[order], kind="stable")]
    sign = rng.choice(np.array([-1, 1], dtype=np.int8), cells)
    # Cells without a colour have bins of their own, which are never chosen. There are several of
    # them, because adding to one bin again and again waits each time for the sum before.
    bins = colours + _SPARE_BINS
    colour = colours + np.arange(cells) % _SPARE_BINS
    colour[order[:colours]] = np.arange(min(colours, cells))

    front = _Front(lattice, bins, colour, known, along)
    front.place(order[:colours], sign)
    for cell in order[colours:].tolist():
        best, around = front.look(cell, colours)
        if around != 0.0:
            sign[cell] = -1 if around > 0.0 else 1
        front.colour(cell, best, sign[cell])
    return colour, sign


class _Front:
    """The colours given so far, and how one cell sees them.

    `colour` (L,) is that of each cell, and is written to; below `bins`.
    """

    def __init__(
        self,
        lattice: tuple[int, int],
        bins: int,
        colour: NDArray[np.int64],
        known: _Links,
        along: tuple[float, float],
    ) -> None:
        rows, cols = lattice
        self._bins, self._colour, self._known, self._cols = bins, colour, known, cols
        self._table, self._placed = colour.reshape(lattice), np.zeros(rows * cols)
        # A narrow copy is searched in a fraction of the time.
        self._narrow = self._table.astype(np.min_scalar_type(bins))
        reach = _reach(bins - _SPARE_BINS)
        self._reach = min(reach, rows - 1), min(reach, cols - 1)
        self._behind = _behind(self._reach, None if known.weight.any() else along)
        self._crowding, self._pull = _kernels(self._reach)
        self._span = 2 * self._reach[1] + 1
        up, down, left, right = self._behind
        above, before = self._reach
        self._inside = self._crowding[
            above - up : above + down + 1, before - left : before + right + 1
        ]
        self._whole = self._inside.ravel()

    def place(self, cells: NDArray[np.int64], sign: NDArray[np.int8]) -> None:
        """Note that these cells have a colour already, with the signs (L,)."""
        self._placed[cells] = sign[cells]

    def look(self, cell: int, colours: int) -> tuple[int, float]:
        """The colour that crowds a cell least, and the sum of its signs around it."""
        row, col = divmod(cell, self._cols)
        up, below, left, right = self._behind
        top, first = max(row - up, 0), max(col - left, 0)
        window = self._table[top : row + below + 1, first : col + right + 1]
        height, width = window.shape
        above, before = self._reach[0] - row + top, self._reach[1] - col + first
        crowds = self._whole  # except at the border, beyond which part of it lies
        if (height, width) != self._inside.shape:
            crowds = self._crowding[above : above + height, before : before + width].ravel()
        crowd = np.bincount(window.ravel(), crowds, self._bins)
        other, strength = self._known.of(cell)
        if other.size:
            crowd += np.bincount(self._colour[other], strength**2, self._bins)
        best = int(crowd[:colours].argmin())
        same = self._narrow[top : top + height, first : first + width] == best
        inside = same.ravel().nonzero()[0]
        down = inside // width
        here = inside + down * (self._cols - width) + (top * self._cols + first)
        there = inside + down * (self._span - width) + (above * self._span + before)
        around = float(self._placed.take(here) @ self._pull.take(there))
        if other.size:
            around += float((self._colour[other] == best) * self._placed[other] @ strength)
        return best, around

    def colour(self, cell: int, colour: int, sign: int) -> None:
        """Give a cell its colour and sign."""
        row, col = divmod(cell, self._cols)
        self._colour[cell] = self._narrow[row, col] = colour
        self._placed[cell] = sign


def choose_phases(
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
        0 .. phases - 1: the one with the least sum(1/d) over those cells of the same colour and
        phase that the front has passed and that are still within reach of `colour_lattice`.
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

    Also that direction, (down, right), not normalised.
    """
    row, col = np.indices(lattice)
    along_row, along_col = rng.random(2) - 0.5
    order = np.argsort((along_row * row + along_col * col).ravel(), kind="stable")
    return order, (float(along_row), float(along_col))


def _behind(reach: tuple[int, int], along: tuple[float, float] | None) -> tuple[int, int, int, int]:
    """How far up, down, left and right of a cell others can have a colour already.

    A front that moves in the direction `along` has not passed what lies ahead of it; without one,
    cells are coloured anywhere.
    """
    if along is None:
        return reach[0], reach[0], reach[1], reach[1]
    bounds = []
    for axis in (0, 1):
        ahead, aside = abs(along[axis]), abs(along[1 - axis])
        tilted = 1 + math.floor(reach[1 - axis] * aside / ahead) if ahead > 0.0 else reach[axis]
        short = min(reach[axis], tilted)
        bounds += [reach[axis], short] if along[axis] > 0.0 else [short, reach[axis]]
    return bounds[0], bounds[1], bounds[2], bounds[3]


def _reach(colours: int) -> int:
    """Distance in cells, up and down, left and right, to which a cell considers others."""
    return max(COLOUR_REACH, math.ceil(RINGS * math.sqrt(colours)))


def _kernels(reach: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """1/d^4 and 1/d of offsets of up to `reach` cells, (2 reach + 1) float64 each way.

    The centre (offset 0) holds 0: a cell does not push itself.
    """
    row = np.arange(-reach[0], reach[0] + 1, dtype=np.float64)
    col = np.arange(-reach[1], reach[1] + 1, dtype=np.float64)
    squared = row[:, None] ** 2 + col**2
    squared[reach] = np.inf
    return 1.0 / squared**2, 1.0 / np.sqrt(squared)
