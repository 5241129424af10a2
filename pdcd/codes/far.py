"""Codes for light from beyond a radius: which cells are lit together, where the mask is closed.

The mask must be closed within the radius of every lit cell. So light of other cells that are lit in
the same code is missed there, and each path from afar is counted only a few times, some often and
some never. Therefore cells are lit seldom, all equally often, and together with others each time.
And the mask is closed at a few more cells, chosen so that what each camera cell misses is spread
evenly over the scene: light that changes slowly from cell to cell then has the right weight,
although its single paths have not.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.codes.alike import (
    CELL_BLOCK_SIDE,
    CHUNK_ENTRIES,
    CellBlock,
    split_into_cell_blocks,
    sum_beyond_radius,
)
from pdcd.codes.greyed import can_make_grey_masks, make_grey_masks

_Indices = NDArray[np.intp]

_SELDOM = 0.5
"""Share of codes in which a cell is lit, over the share that would bring most light. Half of that
share brings two thirds of the light, and leaves room to choose what else is closed."""
_SELDOM_GREY = 0.6
"""With masks of grey levels cells are lit in the square root of the number of those codes, times
this: the fewer are lit together, the less has to be compensated."""
_LEAST_LIGHT = 0.25
"""Cells are lit one by one if that leaves this share of the light, or more."""
MOST_EVENED = 2**22
"""Codes times cells up to which more cells of the mask are closed."""
_FEW = 0.75
"""Share of these cells that still change, below which the finished ones are set aside."""


def choose_times_lit(count: int, cells: int, best: float, *, grey: bool = False) -> int:
    """In how many of `count` codes each of so many cells is lit. `best` is the share of codes that
    brings most light (`pdcd.recipes.programs.LongRangeProgram`), `grey` whether the mask may have
    grey levels.

    With twice as many codes as cells, say, every cell can be lit alone, twice, without any error;
    this is chosen where it does not cost too much light.
    """
    alone = count // cells
    if alone / count >= _LEAST_LIGHT * best * (1.0 - best) ** (1.0 / best - 1.0):
        return alone
    if grey and can_make_grey_masks(count, cells):
        return max(1, round(math.sqrt(_SELDOM_GREY * best * count)))
    return max(1, round(_SELDOM * best * count))


def make_long_range_codes(
    lattice: tuple[int, int],
    count: int,
    best: float,
    rng: np.random.Generator,
    *,
    grey: bool = False,
) -> Bools:
    """Codes (K, L) that light each cell equally often, and about as many cells in each code.

    The codes are split into as many shares as each cell is lit times (`choose_times_lit`); all
    cells are dealt out over the codes of each share by chance.
    """
    cells = lattice[0] * lattice[1]
    times = choose_times_lit(count, cells, best, grey=grey)
    codes = np.zeros((count, cells), dtype=np.bool_)
    for share in np.array_split(rng.permutation(count), times):
        codes[rng.permutation(share)[np.arange(cells) % share.size], rng.permutation(cells)] = True
    return codes


def make_long_range_masks(
    lit: Bools, seen: Bools, lattice: tuple[int, int], radius: int, *, grey: bool = False
) -> Bools | Floats:
    """Where the mask is open, by `make_binary_masks`, or how far, by
    `pdcd.codes.greyed.make_grey_masks`.

    It has no grey levels if there is nothing to compensate, as each code lights one cell, nor if
    choosing them would take long.
    """
    count, cells = lit.shape
    if grey and radius and can_make_grey_masks(count, cells) and lit.sum(axis=1).max() > 1:
        return make_grey_masks(lit, seen, lattice, radius)
    return make_binary_masks(lit, seen, lattice, radius)


def make_binary_masks(lit: Bools, seen: Bools, lattice: tuple[int, int], radius: int) -> Bools:
    """Where the mask is open, (K, L), so that far light is counted as evenly as possible.

    Parameters
    ----------
    lit : (K, L) bool
        Cells of the projector that are lit.
    seen : (K, L) bool
        Cells of the mask that may be open: no cell is lit within the radius of them.
    lattice : (rows, cols), L cells in all
    radius : cells along each axis

    Returns
    -------
    (K, L) bool, open only where `seen` is. It is `seen` with more than `MOST_EVENED` codes times
    cells, and for a radius of 0, where codes are lit half of the time and are even in any case.
    """
    if radius == 0 or lit.size > MOST_EVENED:
        return seen
    bits = lit.astype(np.float64)
    far = sum_beyond_radius(bits, lattice, radius)
    cells = sum_beyond_radius(np.ones((1, lit.shape[1])), lattice, radius)[0]
    open_ = seen.copy()
    group: list[CellBlock] = []
    for block in split_into_cell_blocks(bits, lattice, radius):
        # The matrices of small blocks take as much memory as those of large ones.
        if (
            group
            and (len(group) + 1) * max(block.cells.size, CELL_BLOCK_SIDE**2) * len(lit)
            > CHUNK_ENTRIES
        ):
            _choose(open_, group, far, cells)
            group = []
        group.append(block)
    _choose(open_, group, far, cells)
    return open_


def _choose(open_: Bools, blocks: list[CellBlock], far: Floats, cells: Floats) -> None:
    """Choose the codes in which the cells of some blocks are open; written into `open_`."""
    some = np.concatenate([block.cells for block in blocks])
    of = np.repeat(np.arange(len(blocks)), [block.cells.size for block in blocks])
    together = np.stack([block.together for block in blocks])
    wanted = np.concatenate([block.wanted for block in blocks], axis=1)
    open_[:, some] = _chosen(together, of, wanted, far[:, some], cells[some], open_[:, some])


def _chosen(
    together: Floats, of: _Indices, wanted: Floats, far: Floats, cells: Floats, seen: Bools
) -> Bools:
    """Codes in which some camera cells are open, (K, Y): one change at a time, the best first.

    A cell that is open in the codes a counts the lit cells ``a L``. Their mean over all `cells`
    that are further than the radius, W, is its weight w. Its error in light with the correlation C
    is ``(a L / w - W) C (a L / w - W)``, of which ``W C W`` does not change.

    together : (G, K, K), ``L C L`` of groups of cells; of : (Y,), each cell's group; wanted, far :
    (K, Y), ``L C W`` and ``L W``
    """
    chosen = seen.copy()
    a = seen.astype(np.float64)
    met_by = np.empty_like(a)  # ``L C L a``
    for number, one in enumerate(together):
        met_by[:, of == number] = one @ a[:, of == number]
    own = np.diagonal(together, axis1=1, axis2=2)[of].T
    # For each camera cell: what the error divides by the weight twice, once, and the weight.
    total, met = (a * met_by).sum(axis=0) * cells, 2.0 * (a * wanted).sum(axis=0)
    weight = (a * far).sum(axis=0)
    # Changes of these if an open code is closed, or a closed one opened.
    turn = 1.0 - 2.0 * a
    more_total = (2.0 * turn * met_by + own) * cells
    more_met, more_weight = 2.0 * turn * wanted, turn * far
    never = np.where(seen, 0.0, np.inf)
    which = np.arange(cells.size)
    left = weight > 0.0
    while left.any():
        if left.mean() < _FEW:
            which, of, cells, total, met, weight = (
                x[left] for x in (which, of, cells, total, met, weight)
            )
            turn, more_total, more_met, more_weight, never = (
                x[:, left] for x in (turn, more_total, more_met, more_weight, never)
            )
        after = _error(total + more_total, met + more_met, weight + more_weight)
        after += never
        best = after.argmin(axis=0)
        left = after[best, np.arange(which.size)] < _error(total, met, weight)
        at = np.flatnonzero(left)
        code = best[at]
        chosen[code, which[at]] ^= True
        gained = more_total[code, at]
        total[at] += gained
        met[at] += more_met[code, at]
        weight[at] += more_weight[code, at]
        change = np.zeros(which.size)
        change[at] = 2.0 * turn[code, at] * cells[at]
        more_total += turn * together[of, best].T * change
        more_total[code, at] = -gained
        for of_each in (more_met, more_weight, turn):
            of_each[code, at] *= -1.0
    return chosen


def _error(total: Floats, met: Floats, weight: Floats) -> Floats:
    """``a L C L a / w^2 - 2 a L C W / w`` over the number of cells; infinite without any weight."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error: Floats = (total / weight - met) / weight
    error[~(weight > 0.0)] = np.inf
    return error
