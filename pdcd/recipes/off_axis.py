"""The goals of off-axis benches: light kept or blocked by the depth of what it fell on.

`add_keyed` closes the mask at a camera cell whenever a projector cell is lit that would light it
directly at one of the depths to block (Fig. 11 of the paper): no such light can arrive.
`add_stereo` is white less that. `add_epipolar` separates paths within a row of cells, which all
direct light takes on a rectified bench, from those that change rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Bools, Indices
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.probing.convolved import SameRowPart
from pdcd.probing.wanted import MatchPart, UniformPart
from pdcd.recipes.maker import RecipeMaker
from pdcd.recipes.partners import extend_places, find_match_places, find_matched_cells
from pdcd.recipes.programs import LevelPairs
from pdcd.recipes.recipe import Combination, Rule

_LEAST_PERIODS = 4
"""Least period of a comb, over the number of disparities for which it closes the mask."""


class FewCodesError(RequestError):
    """The goal needs more codes."""


@dataclass(frozen=True, eq=False)
class KeyedProgram:
    """Mask = complement of the code of each cell's match (0 there, p (1 - p) elsewhere).

    A cell without a match gets the complement of a spare code of its row, if the codes have one
    (`pdcd.codes.lines.make_matched_codes`), else it is open.

    place : (N, 2) int64, of `pdcd.recipes.partners.find_match_places`.
    """

    place: Indices
    disparity: int
    coded: bool = True
    p: float = 0.5

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """K pairs."""
        partner = find_matched_cells(
            extend_places(self.place, lattice), self.disparity, lattice.shape
        )
        row = np.arange(partner.size) // lattice.shape[1]
        cells, spare = bits[:, : partner.size], bits[:, partner.size :]
        none = spare[:, row] if spare.shape[1] else np.zeros_like(cells)
        return cells, ~np.where(partner >= 0, cells[:, partner], none)


@dataclass(frozen=True, eq=False)
class KeyedRangeProgram:
    """Mask = closed while a match of any of W disparities is lit by a comb (0 there, 1 in the rest
    of the row, 1 - W / period elsewhere).

    A match beyond the grid closes it, too, when the comb would be there. So all cells are open
    equally often, and see equally much of other rows.
    """

    place: Indices
    low: int
    high: int
    period: int
    coded: bool = True

    @property
    def p(self) -> float:
        """Share of codes in which a cell is lit."""
        return 1.0 / self.period

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """K pairs; `bits` of `pdcd.codes.lines.make_comb_codes`."""
        place, (rows, cols) = extend_places(self.place, lattice), lattice.shape
        # If a match is far off, or there is none: beyond the row, where no real cell is lit then.
        off = (place[:, 0] < 0) | (place[:, 0] >= rows)
        row = np.where(off, 0, place[:, 0])
        column = place[:, 1]
        off |= (column + self.high < 0) | (column + self.low >= cols)
        column = np.where(off, cols - self.low, column)
        opened = np.ones_like(bits)
        first = bits.reshape(-1, rows, cols)[:, :, 0]
        cells = np.arange(len(place))
        for start in range(0, len(bits) - self.period + 1, self.period):
            phase = first[start : start + self.period].argmax(axis=0)[row]
            for disparity in range(self.low, self.high + 1):
                opened[start + (phase + column + disparity) % self.period, cells] = False
        return bits, opened


@dataclass(frozen=True, eq=False)
class RowProgram:
    """Codes h of rows, shown as they are and inverted: mask = the code of the row (K within it,
    K / 2 (1 + h h' / K) elsewhere), or the other way around (0 within it, K / 2 elsewhere where
    codes are orthogonal).

    Their difference is K within rows and exactly 0 elsewhere.
    """

    same: bool
    coded: bool = True
    p: float = 0.5

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """2 K pairs. The code of a row is that of its first cell."""
        rows, cols = lattice.shape
        first = bits.reshape(-1, rows, cols)[:, :, :1]
        code = np.broadcast_to(first, (len(bits), rows, cols)).reshape(len(bits), -1)
        lit = np.stack([code, ~code], axis=1).reshape(-1, rows * cols)
        return lit, lit if self.same else ~lit


def add_keyed(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    """All light except direct light at some depths."""
    kept = _keyed(maker, codes)
    if not white:
        return {"keyed": kept}
    maker.white()
    return {"keyed": kept, "white": ((1.0, "white"),)}


def add_stereo(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    """Direct light at some depths, and other light that takes the same paths."""
    maker.white()
    kept = _keyed(maker, codes)
    less = tuple((-share, name) for share, name in kept)
    return {
        "stereo": ((1.0, "white"), *less),
        "white": ((1.0, "white"),),
        "keyed": kept,
    }


def add_epipolar(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    """Paths within a row, by two shots; or all others, by one."""
    target = maker.target
    line = SameRowPart(target.grid)
    if target.goal.keep == "out":
        maker.coded("epipolar", RowProgram(False), (1.0, UniformPart(target.cells)), (-1.0, line))
    else:
        # Windows that cut cells weigh points of one row differently from cells; direct light, which
        # is nearly all the light within a row, goes from point to point.
        maker.signed("epipolar", RowProgram, (1.0, line), by_direct=True)
    if not white:
        return {"epipolar": ((1.0, "epipolar"),)}
    maker.white()
    return {"epipolar": ((1.0, "epipolar"),), "white": ((1.0, "white"),)}


def _keyed(maker: RecipeMaker, codes: int) -> Combination:
    """The photos whose sum is all light except some depths.

    A comb sees a little less of other rows than of the cell's own. A photo of other rows alone,
    which has no direct light either, adds that share.
    """
    target = maker.target
    grid = target.grid
    low, high = target.goal.disparity or (0, 0)
    place = find_match_places(target.goal, grid, target.planes)
    count = high - low + 1
    everything, line = UniformPart(target.cells), SameRowPart(grid)
    blocked = [(-1.0, MatchPart(find_matched_cells(place, d, grid))) for d in range(low, high + 1)]
    if count == 1:
        maker.coded("keyed", KeyedProgram(place, low), (1.0, everything), *blocked, rows=True)
        return ((1.0, "keyed"),)
    least = _LEAST_PERIODS * count
    if codes < least:
        raise FewCodesError(
            f"{codes} codes are too few to tell {count} disparities from others",
            hint=f"take at least {least} codes, best from {max(least, grid[1] + 1 + count)} on",
        )
    period = choose_comb_period(codes, grid[1], count)
    lost = count / period
    program = KeyedRangeProgram(place, low, high, period)
    maker.coded("other-rows", RowProgram(False), (1.0, everything), (-1.0, line))
    maker.coded("keyed", program, (1.0 - lost, everything), (lost, line), *blocked)
    return ((lost, "other-rows"), (1.0, "keyed"))


def choose_comb_period(codes: int, columns: int, disparities: int) -> int:
    """Codes in which a comb passes a row: as few as keep all its cells apart from all matches, then
    as many as leave the fewest codes unused; all codes where they are too few."""
    least = columns + 1 + disparities
    return codes // max(1, codes // least)
