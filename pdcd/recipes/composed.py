"""How the parts of a wanted matrix are photographed, each in its best way.

Even light needs no codes: few pairs of blocks are exact. Even light with one matched cell each is
a photo of codes with partners, as for the goals indirect and fraction, for any warp. A near band is
what a photo of far light leaves of all light. Other matched cells, and the unexplained rest, are
sums over signed codes (eq. 9), whose errors are in proportion to their own weights only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats, Indices
from pdcd.codes.hadamard import can_make_hadamard_codes
from pdcd.probing.wanted import (
    FullPart,
    GainPart,
    MatchPart,
    MatrixPart,
    NearPart,
    OuterPart,
    UniformPart,
    WantedMatrix,
)
from pdcd.recipes.factored import factor_matrix, find_distinct_rows, find_nonnegative_sides
from pdcd.recipes.maker import RecipeMaker, match_own_cells
from pdcd.recipes.partners import Partner, describe_partners
from pdcd.recipes.programs import (
    CodedProgram,
    SignedBlockProgram,
    SignedMatrixProgram,
    SignedProgram,
)
from pdcd.recipes.recipe import Combination
from pdcd.recipes.structure import Structure, find_nearest_product, find_structure

_FEW_ROWS = 8
"""Number of different rows of a matrix up to which it is photographed as exact blocks before
anything else is tried: few blocks leave each path more light than codes do."""
_FEW_SIDES = 16
"""Rank of a rest up to which it is photographed exactly."""
_MOST_LINES = 4
"""Most matches that are listed one by one."""
_ORDER = {"matched": 1, "coded": 2}
"""Photos whose codes represent those of an answer; the last one does."""
_EQUAL = 1e-6
"""Relative difference up to which weights are equal."""


def compose_matrix(maker: RecipeMaker, codes: int) -> Combination:
    """Takes any matrix A apart (`pdcd.recipes.structure`): its photos, and the sum that is A."""
    matrix = maker.target.matrices["matrix"]
    if _blocks(maker, matrix, min(_FEW_ROWS, codes)):
        return ((1.0, "relit"),)
    found = find_structure(matrix, maker.target.grid)
    if found.found:
        return _Composition(maker, found, codes).terms()
    if _blocks(maker, matrix, codes) or _product(maker, "relit", matrix, codes):
        return ((1.0, "relit"),)
    # With as many codes as cells, signed codes are exact.
    if codes < maker.target.cells:
        found = find_nearest_product(matrix, maker.target.grid)
    if found.found:
        return _Composition(maker, found, codes).terms()
    maker.say("anything", 1.0, "signed codes, two exposures: no structure was found")
    maker.signed(
        "relit", lambda positive: SignedMatrixProgram(matrix, positive), (1.0, FullPart(matrix))
    )
    return ((1.0, "relit"),)


def _blocks(maker: RecipeMaker, matrix: Floats, most: int) -> bool:
    """Adds an exact photo of a matrix with few different rows and no negative weights, if it is
    one: each block is a row and all cells that have it."""
    few = find_distinct_rows(matrix, most) if matrix.min() >= 0.0 else None
    if few is None:
        return False
    distinct, which = few
    camera = [(which == d).astype(np.float64) for d in range(len(distinct))]
    light = np.ones(maker.target.cells) if maker.target.light is None else maker.target.light
    maker.say(f"{len(distinct)} different rows", 1.0, _exact(len(distinct)))
    wanted = maker.wanted((1.0, FullPart(matrix)))
    maker.exact("relit", wanted, camera, list(light * distinct / distinct.max()))
    return True


def _product(maker: RecipeMaker, name: str, matrix: Floats, codes: int) -> bool:
    """Adds an exact photo of a matrix of low rank, if it is one."""
    sides = factor_matrix(matrix, codes // 2)
    if sides is None:
        return False
    _sides(maker, name, *sides, [(1.0, FullPart(matrix))], share=1.0)
    return True


def _sides(
    maker: RecipeMaker,
    name: str,
    camera: Floats,
    projector: Floats,
    parts: list[tuple[float, MatrixPart]],
    share: float,
) -> None:
    """Adds an exact photo of ``camera.T @ projector``, (r, N) each, which is what `parts` add up
    to; in one exposure if sides without negative weights are found."""
    rank = len(camera)
    light = np.ones(maker.target.cells) if maker.target.light is None else maker.target.light
    positive = None if _signs(camera, projector) else find_nonnegative_sides(camera, projector)
    if positive is not None:
        seen, lit = positive
        # Each product is as bright as its panels allow: what one side loses the other gains.
        top = lit.max(axis=1, keepdims=True)
        seen, lit = seen * top, lit / top
        maker.say(f"rank {rank}", share, _exact(rank))
        maker.exact(name, maker.wanted(*parts), list(seen / seen.max()), list(lit * light))
        return
    maker.say(f"rank {rank}, of both signs", share, f"{2 * rank} exact pairs, two exposures")
    maker.signed(name, lambda sign: SignedBlockProgram(camera, projector * light, sign), *parts)


def _signs(camera: Floats, projector: Floats) -> bool:
    """Whether a product of sides has negative weights, judged by some of its rows."""
    some = camera[:, :: max(1, camera.shape[1] // 256)].T @ projector
    return bool(some.min() < -_EQUAL * some.max())


def _exact(pairs: int) -> str:
    return f"{pairs} exact pair{'s' * (pairs > 1)}, one exposure"


@dataclass(frozen=True)
class _Shares:
    """Squared weights of the parts of a structure, over their sum."""

    even: float
    level: float
    near: float
    matches: tuple[float, ...]
    rest: float

    @classmethod
    def of(cls, found: Structure) -> _Shares:
        def squares(*parts: tuple[float, MatrixPart]) -> float:
            behind = tuple((weight, GainPart(found.gain, part)) for weight, part in parts)
            wanted = WantedMatrix(found.grid, behind, found.light)
            return float(wanted.squares().sum() + np.sum(wanted.diagonal() ** 2))

        products = zip(found.camera, found.projector, strict=True)
        even = squares(*((1.0, OuterPart(*sides)) for sides in products))
        level = squares((found.level, UniformPart(found.gain.size)))
        near = sum(squares((w, NearPart(found.grid, radius))) for w, radius in found.near)
        matches = [squares((weight, MatchPart(partner))) for weight, partner in found.matches]
        rest = 0.0 if found.rest is None else squares((1.0, FullPart(found.rest)))
        total = even + level + near + sum(matches) + rest
        shared = tuple(squared / total for squared in matches)
        return cls(even / total, level / total, near / total, shared, rest / total)


class _Composition:
    """Turns a structure into photos, one part after the other."""

    def __init__(self, maker: RecipeMaker, found: Structure, codes: int) -> None:
        self._maker, self._found, self._codes = maker, found, codes
        cells = maker.target.cells
        ones = np.ones(cells)
        self._gain = None if np.array_equal(found.gain, ones) else found.gain
        self._light = None if np.array_equal(found.light, ones) else found.light
        self._shares = _Shares.of(found)
        self._terms: list[tuple[float, str]] = []

    def terms(self) -> Combination:
        """All photos, and the sum of them that is the matrix; the photo that represents the codes
        comes last."""
        found = self._found
        # A band is what far light leaves of all light.
        level = found.level + sum(weight for weight, _ in found.near)
        matches = list(zip(found.matches, self._shares.matches, strict=True))
        if level > _EQUAL * max(abs(found.level), _EQUAL) and matches:
            level = self._partners(level, matches)
        if abs(level) > _EQUAL * max(1.0, abs(found.level)):
            self._white(level)
        for weight, radius in found.near:
            self._far(weight, radius)
        if len(found.camera):
            self._product("even", found.camera, found.projector, self._shares.even)
        rest = found.rest
        few = None if rest is None else factor_matrix(rest, min(_FEW_SIDES, self._codes // 2))
        if few is not None:
            self._product("blocks", few[0] * found.gain, few[1] * found.light, self._shares.rest)
            rest = None
        if matches or rest is not None:
            self._matched(matches, rest)
        return tuple(sorted(self._terms, key=lambda term: _ORDER.get(term[1], 0)))

    def _product(self, name: str, camera: Floats, projector: Floats, share: float) -> None:
        sides = zip(camera, projector, strict=True)
        _sides(
            self._maker, name, camera, projector, [(1.0, OuterPart(c, p)) for c, p in sides], share
        )
        self._terms.append((1.0, name))

    def _partners(self, level: float, matches: list[tuple[tuple[float, Indices], float]]) -> float:
        """Even light with one matched cell each, by codes with partners. The match is removed from
        the list, and what is left of the level is returned."""
        pick = max(range(len(matches)), key=lambda k: np.count_nonzero(matches[k][0][1] >= 0))
        (weight, partner), share = matches[pick]
        kept = 1.0 + weight / level
        if kept < -_EQUAL or np.count_nonzero(partner >= 0) < partner.size // 2:
            return level
        del matches[pick]
        maker, cells = self._maker, self._maker.target.cells
        there = partner >= 0
        gain = self._gain
        if not there.all():  # cells without a partner stay closed in such codes
            alone = np.where(there, 0.0, 1.0 if gain is None else gain)
            if alone.any():
                self._even("unmatched", level, alone)
            gain = None if gain is None else np.where(there, gain, 0.0)
        how = describe_partners(partner, maker.target.grid)
        everything = (
            UniformPart(cells) if there.all() else OuterPart(there.astype(float), np.ones(cells))
        )
        match = match_own_cells(maker.target) if how is None else MatchPart(partner)
        share += self._shares.level
        if kept <= 1.0:
            left = 0.0 if abs(kept) <= _EQUAL else kept
            maker.say(
                f"all but {_words(how)}",
                share,
                "codes with their complements, one exposure"
                + f", and {100.0 * left:.3g} % of white" * (left > 0.0),
            )
            maker.coded(
                "coded", CodedProgram(how, True), (1.0, everything), (-1.0, match),
                light=self._light, gain=gain,
            )  # fmt: skip
            self._terms.append((level * (1.0 - left), "coded"))
            if left:
                white = there.astype(float) if gain is None else gain
                self._even("kept", level * left, white)
            return 0.0
        return self._fraction(level, kept, how, everything, match, share, gain)

    def _fraction(
        self,
        level: float,
        kept: float,
        how: Partner,
        everything: OuterPart,
        match: MatchPart,
        share: float,
        gain: Floats | None,
    ) -> float:
        """Matched cells and a share p of the rest: codes lit with that probability, and white light
        where there are no codes for that p."""
        p = _lit(kept, self._codes)
        coded = (kept - 1.0) / (1.0 / p - 1.0)
        coded = 1.0 if abs(coded - 1.0) <= _EQUAL else coded
        self._maker.say(
            f"{_words(how)} and {100.0 / kept:.3g} % of the rest", share,
            f"codes lit with p = {p:.4g}, one exposure" + ", and white" * (coded < 1.0),
        )  # fmt: skip
        self._maker.coded(
            "coded", CodedProgram(how, False, p), (p, everything), (1.0 - p, match),
            light=self._light, gain=gain, by_direct=True, by_light=how is not None,
        )  # fmt: skip
        self._terms.append((level * coded / p, "coded"))
        if coded < 1.0:
            white = everything.camera if gain is None else gain
            self._even("kept", level * (1.0 - coded), white)
        return 0.0

    def _white(self, level: float) -> None:
        """Even light alone, exactly."""
        self._maker.say("all light alike", self._shares.level, _exact(1))
        if self._gain is None and self._light is None:
            self._maker.white()
            self._terms.append((level, "white"))
            return
        gain = np.ones(self._maker.target.cells) if self._gain is None else self._gain
        self._even("alike", level, gain)

    def _even(self, name: str, weight: float, gain: Floats) -> None:
        """Even light behind a gain, exactly."""
        ones = np.ones(gain.size)
        light = self._maker.lit(self._light)
        wanted = WantedMatrix(
            self._maker.target.grid, ((1.0, GainPart(gain, UniformPart(gain.size))),), light
        )
        self._maker.exact(name, wanted, [gain], [ones if light is None else light])
        self._terms.append((weight, name))

    def _far(self, weight: float, radius: int) -> None:
        """A band of some weight: even light, which is counted already, less far light."""
        maker, name = self._maker, f"far-{radius}"
        share = self._shares.near + (0.0 if self._terms else self._shares.level)
        maker.say(
            f"{'within' if weight > 0.0 else 'beyond'} {radius} cells", share,
            "codes that are dark around what is lit, one exposure",
        )  # fmt: skip
        maker.far(name, radius, light=self._light, gain=self._gain)
        self._terms.append((-weight, name))

    def _matched(
        self, matches: list[tuple[tuple[float, Indices], float]], rest: Floats | None
    ) -> None:
        """Matched cells and the rest, by signed codes in one pair of exposures."""
        maker, grid = self._maker, self._maker.target.grid
        how = "signed codes, two exposures"
        if len(matches) > _MOST_LINES:
            maker.say(f"{len(matches)} matched cells each", sum(s for _, s in matches), how)
        else:
            for (weight, partner), share in matches:
                maker.say(
                    f"{weight:.4g} times {_words(describe_partners(partner, grid))}", share, how
                )
        taps = tuple((weight, describe_partners(partner, grid)) for (weight, partner), _ in matches)
        parts = [(weight, MatchPart(partner)) for (weight, partner), _ in matches]
        self._terms.append((1.0, "matched"))
        if rest is None:
            maker.signed(
                "matched", lambda positive: SignedProgram(taps, positive), *parts,
                light=self._light, gain=self._gain,
            )  # fmt: skip
            return
        left = rest.copy() if taps else rest
        cells = tuple(partner for (_, partner), _ in matches)
        for (weight, partner), _ in matches:
            there = np.flatnonzero(partner >= 0)
            left[there, partner[there]] += weight
        maker.say("the rest", self._shares.rest, how + ", with those" * bool(taps))
        maker.signed(
            "matched", lambda positive: SignedMatrixProgram(left, positive, cells), (1.0,
            FullPart(left)),
            light=self._light, gain=self._gain,
        )  # fmt: skip


def _lit(kept: float, codes: int) -> float:
    """The share of codes to light a cell in that keeps matched cells `kept` times as much as the
    others, or somewhat more: the largest one for which there are Hadamard codes, else any."""
    for half in range(1, 17):
        p = 2.0**-half
        if p * kept <= 1.0 + _EQUAL and can_make_hadamard_codes(codes, p):
            return p
    return max(1, int(codes / kept + _EQUAL)) / codes


def _words(partner: Partner) -> str:
    if partner is None:
        return "the cell itself"
    return (
        f"the cell at {partner[0]} {partner[1]}" if isinstance(partner, tuple) else "one cell each"
    )
