"""Goal -> the shots to take, and the linear combination of them that is the answer.

A *photo* is a signed sum of shots with one wanted probing matrix, so one scale: a single coded
shot, a signed pair (eq. 10), or either with the shots that measure what leaks through black panels.
The answer, and the pictures shown beside it, are linear combinations of photos after each has been
divided by its own realised weight: subtracting photos of unequal weight would be wrong (erratum
X9).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pdcd.goals import Goal
from pdcd.programs import Blocks, Coded, Far, Program, Signed, SignedBlocks, SignedMatrix
from pdcd.request import BlackLevel
from pdcd.wanted import Full, Indices, Match, Near, Outer, Part, Uniform, Wanted, shifted

Combination = tuple[tuple[float, str], ...]
"""(coefficient, name) pairs."""

Partner = Indices | tuple[int, int] | None

# The other shots of each way to remove what black panels let through, as (sign, projector black,
# mask black): mask leak, ambient light and projector leak, and both (limitations L1 to L3).
_BLACKS: dict[str, tuple[tuple[float, bool, bool], ...]] = {
    "none": (),
    "mask": ((-1.0, False, True),),
    "ambient": ((-1.0, True, False),),
    "both": ((-1.0, False, True), (-1.0, True, False), (1.0, True, True)),
}

RANK_TOLERANCE = 1e-10
"""Singular values below this share of the largest count as zero."""


@dataclass(frozen=True)
class Shot:
    """One exposure: the program whose pairs it shows, and which panels stay black instead.

    `white` shots show full light through a fully open mask.
    """

    name: str
    program: str
    white: bool = False
    primal_black: bool = False
    dual_black: bool = False


@dataclass(frozen=True)
class Photo:
    """A signed sum of shots that is to have a wanted probing matrix, up to one scale.

    With `row_weights` each cell is divided by its own realised weight instead of the common one,
    for codes whose cells are open unequally often by design.
    """

    name: str
    wanted: Wanted
    shots: Combination
    row_weights: bool = False


@dataclass(frozen=True)
class Recipe:
    """Shots, photos and pictures of one goal; `pictures` maps a name to photos, answer first."""

    goal: Goal
    programs: dict[str, Program]
    shots: tuple[Shot, ...]
    photos: tuple[Photo, ...]
    pictures: dict[str, Combination]

    @property
    def answer(self) -> Combination:
        """The combination of photos that is the wanted image."""
        return next(iter(self.pictures.values()))

    @property
    def wanted(self) -> Wanted:
        """The goal's own wanted matrix: that of the answer."""
        photos = {photo.name: photo.wanted for photo in self.photos}
        parts = [
            (coefficient * weight, part)
            for coefficient, name in self.answer
            for weight, part in photos[name].parts
        ]
        return Wanted(self.goal.grid, tuple(parts), self.goal.light)


class _Maker:
    """Collects the programs, shots and photos of one recipe."""

    def __init__(self, goal: Goal, black_level: BlackLevel) -> None:
        self.goal = goal
        self.blacks = _BLACKS[black_level]
        self.programs: dict[str, Program] = {}
        self.shots: list[Shot] = []
        self.photos: list[Photo] = []

    def white(self) -> None:
        """A photo of everything: a floodlit shot, or the illumination through an open mask."""
        wanted = Wanted(self.goal.grid, ((1.0, Uniform(_cells(self.goal))),), self.goal.light)
        if self.goal.light is None:
            self._photo("white", wanted, [(1.0, Shot("white", "", white=True))])
        else:
            self.exact("white", wanted, [np.ones(_cells(self.goal))], [self.goal.light])

    def coded(self, name: str, program: Program, *parts: tuple[float, Part]) -> None:
        """A photo of one coded shot."""
        self.programs[name] = program
        self._photo(name, self._wanted(*parts), [(1.0, Shot(name, name))], isinstance(program, Far))

    def signed(
        self, name: str, half: Callable[[bool], Program], *parts: tuple[float, Part]
    ) -> None:
        """A photo that is the difference of two shots."""
        shots = []
        for sign, positive in ((1.0, True), (-1.0, False)):
            part = f"{name}-{'plus' if positive else 'minus'}"
            self.programs[part] = half(positive)
            shots.append((sign, Shot(part, part)))
        self._photo(name, self._wanted(*parts), shots)

    def exact(self, name: str, wanted: Wanted, camera: list, projector: list) -> None:  # type: ignore[type-arg]
        """A photo of few exact, non-negative blocks."""
        self.programs[name] = Blocks(np.array(camera), np.array(projector))
        self._photo(name, wanted, [(1.0, Shot(name, name))])

    def _wanted(self, *parts: tuple[float, Part]) -> Wanted:
        return Wanted(self.goal.grid, parts, self.goal.light)

    def _photo(
        self,
        name: str,
        wanted: Wanted,
        shots: list[tuple[float, Shot]],
        row_weights: bool = False,
    ) -> None:
        terms = []
        for sign, shot in shots:
            self.shots.append(shot)
            terms.append((sign, shot.name))
            for black_sign, primal, dual in self.blacks:
                sides = [s for s, black in (("primal", primal), ("dual", dual)) if black]
                extra = Shot(
                    f"{shot.name}-black-{'-'.join(sides)}", shot.program, shot.white, primal, dual
                )
                self.shots.append(extra)
                terms.append((sign * black_sign, extra.name))
        self.photos.append(Photo(name, wanted, tuple(terms), row_weights))


def make_recipe(
    goal: Goal, *, black_level: BlackLevel = "none", white: bool = True, codes: int = 128
) -> Recipe:
    """The recipe for a goal that `check_goal` has passed.

    Parameters
    ----------
    black_level : which leaks to measure with further shots and subtract (limitations L1-L3).
    white : take a white shot beside the coded one of the goal "indirect".
    codes : number of codes K; exact decompositions are taken where they need fewer pairs.
    """
    maker = _Maker(goal, black_level)
    pictures = _RECIPES[goal.name](maker, white, codes)
    return Recipe(goal, maker.programs, tuple(maker.shots), tuple(maker.photos), pictures)


def _cells(goal: Goal) -> int:
    return goal.grid[0] * goal.grid[1]


def _same(goal: Goal) -> Match:
    return Match(np.arange(_cells(goal)))


def _all_but_direct(maker: _Maker) -> None:
    goal = maker.goal
    maker.coded("coded", Coded(None, True), (1.0, Uniform(_cells(goal))), (-1.0, _same(goal)))


def _white(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    maker.white()
    return {"white": ((1.0, "white"),)}


def _indirect(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    if not white:
        _all_but_direct(maker)
        return {"indirect": ((1.0, "coded"),)}
    maker.white()
    _all_but_direct(maker)
    direct = ((1.0, "white"), (-1.0, "coded"))
    return {"indirect": ((1.0, "coded"),), "white": ((1.0, "white"),), "direct": direct}


def _direct(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    pictures = _indirect(maker, True, codes)
    return {name: pictures[name] for name in ("direct", "white", "indirect")}


def _fraction(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    goal = maker.goal
    p = goal.p or 0.0
    everything, same = Uniform(_cells(goal)), _same(goal)
    maker.coded("coded", Coded(None, False, p), (p, everything), (1.0 - p, same))
    return {"fraction": ((1.0, "coded"),)}


def _matched(maker: _Maker, name: str, partner: Partner) -> None:
    """A photo of one chosen projector cell for each camera cell, by signed codes."""
    grid = maker.goal.grid
    if partner is None:
        part = _same(maker.goal)
    else:
        part = Match(shifted(grid, partner) if isinstance(partner, tuple) else partner)
    maker.signed(name, lambda positive: Signed(((1.0, partner),), positive), (1.0, part))


def _diagonal(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    _matched(maker, "matched", None)
    return {"diagonal": ((1.0, "matched"),)}


def _off_diagonal(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    _matched(maker, "matched", maker.goal.shift)
    return {"off-diagonal": ((1.0, "matched"),)}


def _warped(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    _matched(maker, "matched", maker.goal.planes["warp"].astype(np.int64))
    return {"warped": ((1.0, "matched"),)}


def _two_samples(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    a, b = maker.goal.mix or (0.0, 0.0)
    _matched(maker, "first", maker.goal.planes["warp"].astype(np.int64))
    _matched(maker, "second", maker.goal.planes["warp_b"].astype(np.int64))
    return {"two-samples": ((a, "first"), (b, "second"))}


def _illuminated(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    maker.white()
    return {"illuminated": ((1.0, "white"),)}


def _far(maker: _Maker) -> None:
    goal = maker.goal
    radius = goal.radius or 0
    everything = (1.0, Uniform(_cells(goal)))
    maker.coded("far", Far(radius), everything, (-1.0, Near(goal.grid, radius)))


def _long_range(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    _far(maker)
    return {"long-range": ((1.0, "far"),)}


def _short_range(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    _all_but_direct(maker)
    _far(maker)
    pictures: dict[str, Combination] = {"short-range": ((1.0, "coded"), (-1.0, "far"))}
    return {**pictures, "indirect": ((1.0, "coded"),), "long-range": ((1.0, "far"),)}


def _blocked(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    """Two exact pairs: all light seen outside A, and all light but B's seen inside A."""
    planes = maker.goal.planes
    a, b = planes["region_a"], planes["region_b"]
    light = np.ones(_cells(maker.goal)) if maker.goal.light is None else maker.goal.light
    parts = ((1.0, Uniform(_cells(maker.goal))), (-1.0, Outer(a, b)))
    wanted = Wanted(maker.goal.grid, parts, maker.goal.light)
    maker.exact("blocked", wanted, [1.0 - a, a], [light, light * (1.0 - b)])
    return {"blocked": ((1.0, "blocked"),)}


def _descattered(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    goal = maker.goal
    there = shifted(goal.grid, goal.shift or (0, 0))
    # Cells without a neighbour there stay closed, so that both samples cover the same cells.
    here = np.where(there >= 0, np.arange(_cells(goal)), -1)
    parts = ((1.0, Match(here)), (-1.0, Match(there)))
    taps = ((1.0, here), (-1.0, goal.shift))
    maker.signed("difference", lambda positive: Signed(taps, positive), *parts)
    return {"descattered": ((1.0, "difference"),)}


def _filtered(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    """``sum_w f_w T_{n, n-w}``: tap w of the kernel pairs n with n - w (Table 2, row 7; X11)."""
    goal = maker.goal
    kernel = goal.matrices["kernel"]
    centre = (kernel.shape[0] // 2, kernel.shape[1] // 2)
    taps = []
    for down, right in zip(*np.nonzero(kernel), strict=True):
        shift = (centre[0] - int(down), centre[1] - int(right))
        taps.append((float(kernel[down, right]), shift))
    parts = [(weight, Match(shifted(goal.grid, shift))) for weight, shift in taps]
    maker.signed("filtered", lambda positive: Signed(tuple(taps), positive), *parts)
    return {"filtered": ((1.0, "filtered"),)}


def _relit(maker: _Maker, white: bool, codes: int) -> dict[str, Combination]:
    """Any matrix A: exact blocks where A has few distinct rows or a low rank, else eq. 9."""
    goal = maker.goal
    matrix = goal.matrices["matrix"]
    light = np.ones(_cells(goal)) if goal.light is None else goal.light
    wanted = Wanted(goal.grid, ((1.0, Full(matrix)),), goal.light)
    distinct, which = np.unique(matrix, axis=0, return_inverse=True)
    answer: dict[str, Combination] = {"relit": ((1.0, "relit"),)}
    if matrix.min() >= 0.0 and len(distinct) <= codes:
        camera = [(which.ravel() == d).astype(np.float64) for d in range(len(distinct))]
        maker.exact("relit", wanted, camera, list(light * distinct / distinct.max()))
        return answer
    u, s, vt = np.linalg.svd(matrix)
    rank = int(np.sum(s > RANK_TOLERANCE * s[0]))
    if 2 * rank <= codes:
        root = np.sqrt(s[:rank])
        camera_side, projector_side = (u[:, :rank] * root).T, vt[:rank] * root[:, None] * light
        maker.signed(
            "relit",
            lambda positive: SignedBlocks(camera_side, projector_side, positive),
            (1.0, Full(matrix)),
        )
        return answer
    maker.signed("relit", lambda positive: SignedMatrix(matrix, positive), (1.0, Full(matrix)))
    return answer


_RECIPES: dict[str, Callable[[_Maker, bool, int], dict[str, Combination]]] = {
    "white": _white,
    "indirect": _indirect,
    "direct": _direct,
    "fraction": _fraction,
    "illuminated": _illuminated,
    "diagonal": _diagonal,
    "off-diagonal": _off_diagonal,
    "warped": _warped,
    "two-samples": _two_samples,
    "relit": _relit,
    "long-range": _long_range,
    "short-range": _short_range,
    "blocked": _blocked,
    "descattered": _descattered,
    "filtered": _filtered,
}
