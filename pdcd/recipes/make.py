"""How each goal is photographed: its shots, photos and pictures, one small function a goal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from pdcd.errors import ConfigError
from pdcd.probing.wanted import Full, Indices, Match, Near, Outer, Part, Uniform, Wanted, shifted
from pdcd.recipes.alternatives import checkers, fitted_weights, masked_weights, shares
from pdcd.recipes.goals import Goal
from pdcd.recipes.programs import (
    Blocks,
    Coded,
    Far,
    Floats,
    Floodlit,
    Program,
    Signed,
    SignedBlocks,
    SignedMatrix,
    Under,
)
from pdcd.recipes.recipe import Extremes, Photo, Recipe, Rule, Shot
from pdcd.words import BlackLevel, MethodName

Partner = Indices | tuple[int, int] | None

# The other shots of each way to remove what black panels let through, as (sign, projector black,
# mask black): mask leak, ambient light and projector leak, and both (limitations L1 to L3).
_BLACKS: dict[str, tuple[tuple[float, bool, bool], ...]] = {
    "none": (),
    "mask": ((-1.0, False, True),),
    "ambient": ((-1.0, True, False),),
    "both": ((-1.0, False, True), (-1.0, True, False), (1.0, True, True)),
}

STRIPES = 4
"""Positions of the stripes of the goal "split"."""

RANK_TOLERANCE = 1e-10
"""Singular values below this share of the largest count as zero."""


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
            self.photo("white", wanted, [(1.0, Shot("white", "", white=True))])
        else:
            self.exact("white", wanted, [np.ones(_cells(self.goal))], [self.goal.light])

    def coded(
        self,
        name: str,
        program: Program,
        *parts: tuple[float, Part],
        light: Floats | None = None,
        by_direct: bool = False,
    ) -> None:
        """A photo of one coded shot, under `light` beside the goal's own."""
        wanted = replace(self.wanted(*parts), by_direct=by_direct)
        rows = isinstance(program, Far)
        if light is not None:
            program = Under(program, light)
            wanted = wanted.under(light if wanted.light is None else light * wanted.light)
        self.programs[name] = program
        self.photo(name, wanted, [(1.0, Shot(name, name))], rows)

    def signed(
        self, name: str, half: Callable[[bool], Program], *parts: tuple[float, Part]
    ) -> None:
        """A photo that is the difference of two shots."""
        shots = []
        for sign, positive in ((1.0, True), (-1.0, False)):
            part = f"{name}-{'plus' if positive else 'minus'}"
            self.programs[part] = half(positive)
            shots.append((sign, Shot(part, part)))
        self.photo(name, self.wanted(*parts), shots)

    def exact(self, name: str, wanted: Wanted, camera: list, projector: list) -> None:  # type: ignore[type-arg]
        """A photo of few exact, non-negative blocks."""
        self.programs[name] = Blocks(np.array(camera), np.array(projector))
        self.photo(name, wanted, [(1.0, Shot(name, name))])

    def wanted(self, *parts: tuple[float, Part]) -> Wanted:
        """A wanted matrix under the goal's illumination."""
        return Wanted(self.goal.grid, parts, self.goal.light)

    def kept(self, direct: float, indirect: float) -> Wanted:
        """The wanted matrix of these shares of direct and of indirect light."""
        everything, same = Uniform(_cells(self.goal)), _same(self.goal)
        return self.wanted((indirect, everything), (direct - indirect, same))

    def photo(
        self,
        name: str,
        wanted: Wanted,
        shots: list[tuple[float, Shot]],
        row_weights: bool = False,
    ) -> None:
        """A photo of some shots, each with the black ones that measure its leaks."""
        terms = []
        for sign, shot in shots:
            self.shots.append(shot)
            terms.append((sign, shot.name))
            for black_sign, primal, dual in self.blacks:
                sides = [s for s, black in (("primal", primal), ("dual", dual)) if black]
                extra = replace(
                    shot,
                    name=f"{shot.name}-black-{'-'.join(sides)}",
                    primal_black=primal,
                    dual_black=dual,
                )
                self.shots.append(extra)
                terms.append((sign * black_sign, extra.name))
        self.photos.append(Photo(name, wanted, tuple(terms), row_weights))


def make_recipe(
    goal: Goal,
    *,
    black_level: BlackLevel = "none",
    white: bool = True,
    codes: int = 128,
    pilot: int = 0,
    method: MethodName = "coded",
) -> Recipe:
    """The recipe for a goal that `check_goal` has passed.

    Parameters
    ----------
    black_level : which leaks to measure with further shots and subtract (limitations L1-L3).
    white : take a white shot beside the coded one of the goal "indirect".
    codes : number of codes K; exact decompositions are taken where they need fewer pairs.
    pilot : number of codes to photograph one by one first, through an open mask. Where none of the
        `codes` are left, the coded photo is made of the pilot's.
    method : codes on both panels, or one of `pdcd.recipes.alternatives`.
    """
    maker = _Maker(goal, black_level)
    if method != "coded":
        if pilot:
            raise ConfigError(f"method {method} takes no pilot", hint="leave it out")
        return _multi_image(maker, codes) if method == "multi-image" else _nayar(maker)
    pictures = _RECIPES[goal.name](maker, white, codes)
    recipe = Recipe(goal, maker.programs, tuple(maker.shots), tuple(maker.photos), pictures)
    if pilot:
        recipe = _with_pilot(recipe, pilot)
    return recipe if codes else _pilot_alone(recipe)


def _with_pilot(recipe: Recipe, count: int) -> Recipe:
    """The same with `count` photos of single codes through an open mask before the coded shots."""
    if "coded" not in recipe.programs or recipe.goal.name == "fraction":
        raise ConfigError(
            f"goal {recipe.goal.name} takes no pilot",
            hint="a pilot helps indirect and direct light",
        )
    stack = tuple(Shot(f"pilot-{k + 1:04d}", "pilot", only=k) for k in range(count))
    first = next(i for i, shot in enumerate(recipe.shots) if shot.program == "coded")
    return replace(
        recipe,
        programs={"pilot": Floodlit(), **recipe.programs},
        shots=(*recipe.shots[:first], *stack, *recipe.shots[first:]),
        stack=tuple(shot.name for shot in stack),
    )


def _pilot_alone(recipe: Recipe) -> Recipe:
    """The same with the pilot's photos, masked in software, in the place of the coded shot."""
    if recipe.goal.name not in ("indirect", "direct"):
        raise ConfigError(
            f"a pilot leaves no codes for the goal {recipe.goal.name}",
            hint="ask for more codes or a smaller pilot",
        )
    coded = next(photo for photo in recipe.photos if photo.name == "coded")
    if len(coded.shots) > 1 or recipe.goal.light is not None:
        raise ConfigError(
            "a pilot of all codes takes neither black exposures nor an illumination",
            hint="leave them out, or ask for more codes",
        )
    return replace(
        recipe,
        programs={name: p for name, p in recipe.programs.items() if name != "coded"},
        shots=tuple(shot for shot in recipe.shots if shot.name != "coded"),
        sums={"coded": partial(fitted_weights, direct=0.0, indirect=1.0)},
    )


def _multi_image(maker: _Maker, codes: int) -> Recipe:
    """Single codes through an open mask, one RAW file each, masked in software."""
    goal = maker.goal
    direct, indirect = shares(goal, "multi-image")
    if codes < 2:
        raise ConfigError("the method multi-image needs at least 2 codes")
    if maker.blacks:
        raise ConfigError(
            "the method multi-image takes no black exposures", hint="take the black level none"
        )
    stack = tuple(Shot(f"photo-{k + 1:04d}", "photos", only=k) for k in range(codes))
    kept = {
        goal.name: (direct, indirect),
        "white": (1.0, 1.0),
        "direct": (1.0, 0.0),
        "indirect": (0.0, 1.0),
    }
    sums = {name: partial(fitted_weights, direct=d, indirect=i) for name, (d, i) in kept.items()}
    return Recipe(
        goal,
        {"photos": Floodlit()},
        stack,
        tuple(
            Photo(name, maker.kept(d, i), ((1.0, name),))
            for name, (d, i) in {**kept, "masked": (0.0, 1.0)}.items()
        ),
        {name: ((1.0, name),) for name in (*kept, "masked")},
        stack=tuple(shot.name for shot in stack),
        sums={**sums, "masked": masked_weights},
    )


def _nayar(maker: _Maker) -> Recipe:
    """Checkers through an open mask; the answer is made of the largest and smallest photo."""
    goal = maker.goal
    direct, indirect = shares(goal, "nayar")
    patterns = checkers(goal.grid)
    names = tuple(f"checker-{k + 1}" for k in range(len(patterns)))
    maker.programs["checkers"] = Blocks(np.ones_like(patterns), patterns)
    everything = maker.kept(1.0, 1.0)
    for k, name in enumerate(names):
        shot = Shot(name, "checkers", only=k)
        maker.photo(name, everything.under(patterns[k]), [(1.0, shot)])
    pictures: dict[str, Rule] = {
        goal.name: Extremes(direct, 2.0 * indirect - direct, names),
        "white": tuple((2.0 / len(names), name) for name in names),
        "direct": Extremes(1.0, -1.0, names),
        "indirect": Extremes(0.0, 2.0, names),
    }
    return Recipe(
        goal,
        maker.programs,
        tuple(maker.shots),
        tuple(maker.photos),
        pictures,
        stack=names,
        meant=maker.kept(direct, indirect),
    )


def _cells(goal: Goal) -> int:
    return goal.grid[0] * goal.grid[1]


def _same(goal: Goal) -> Match:
    return Match(np.arange(_cells(goal)))


def _all_but_direct(maker: _Maker) -> None:
    goal = maker.goal
    maker.coded("coded", Coded(None, True), (1.0, Uniform(_cells(goal))), (-1.0, _same(goal)))


def _white(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    maker.white()
    return {"white": ((1.0, "white"),)}


def _indirect(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    if not white:
        _all_but_direct(maker)
        return {"indirect": ((1.0, "coded"),)}
    maker.white()
    _all_but_direct(maker)
    direct = ((1.0, "white"), (-1.0, "coded"))
    return {"indirect": ((1.0, "coded"),), "white": ((1.0, "white"),), "direct": direct}


def _direct(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    pictures = _indirect(maker, True, codes)
    return {name: pictures[name] for name in ("direct", "white", "indirect")}


def _fraction(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    goal = maker.goal
    p = goal.p or 0.0
    everything, same = Uniform(_cells(goal)), _same(goal)
    maker.coded("coded", Coded(None, False, p), (p, everything), (1.0 - p, same), by_direct=True)
    return {"fraction": ((1.0, "coded"),)}


def _matched(maker: _Maker, name: str, partner: Partner) -> None:
    """A photo of one chosen projector cell for each camera cell, by signed codes."""
    grid = maker.goal.grid
    if partner is None:
        part = _same(maker.goal)
    else:
        part = Match(shifted(grid, partner) if isinstance(partner, tuple) else partner)
    maker.signed(name, lambda positive: Signed(((1.0, partner),), positive), (1.0, part))


def _diagonal(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    _matched(maker, "matched", None)
    return {"diagonal": ((1.0, "matched"),)}


def _off_diagonal(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    _matched(maker, "matched", maker.goal.shift)
    return {"off-diagonal": ((1.0, "matched"),)}


def _warped(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    _matched(maker, "matched", maker.goal.planes["warp"].astype(np.int64))
    return {"warped": ((1.0, "matched"),)}


def _two_samples(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    a, b = maker.goal.mix or (0.0, 0.0)
    _matched(maker, "first", maker.goal.planes["warp"].astype(np.int64))
    _matched(maker, "second", maker.goal.planes["warp_b"].astype(np.int64))
    return {"two-samples": ((a, "first"), (b, "second"))}


def _illuminated(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    maker.white()
    return {"illuminated": ((1.0, "white"),)}


def _far(maker: _Maker) -> None:
    goal = maker.goal
    radius = goal.radius or 0
    everything = (1.0, Uniform(_cells(goal)))
    maker.coded("far", Far(radius), everything, (-1.0, Near(goal.grid, radius)))


def _long_range(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    _far(maker)
    return {"long-range": ((1.0, "far"),)}


def _short_range(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    _all_but_direct(maker)
    _far(maker)
    pictures: dict[str, Rule] = {"short-range": ((1.0, "coded"), (-1.0, "far"))}
    return {**pictures, "indirect": ((1.0, "coded"),), "long-range": ((1.0, "far"),)}


def _blocked(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    """Two exact pairs: all light seen outside A, and all light but B's seen inside A."""
    planes = maker.goal.planes
    a, b = planes["region_a"], planes["region_b"]
    light = np.ones(_cells(maker.goal)) if maker.goal.light is None else maker.goal.light
    parts = ((1.0, Uniform(_cells(maker.goal))), (-1.0, Outer(a, b)))
    wanted = Wanted(maker.goal.grid, parts, maker.goal.light)
    maker.exact("blocked", wanted, [1.0 - a, a], [light, light * (1.0 - b)])
    return {"blocked": ((1.0, "blocked"),)}


def _descattered(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    goal = maker.goal
    there = shifted(goal.grid, goal.shift or (0, 0))
    # Cells without a neighbour there stay closed, so that both samples cover the same cells.
    here = np.where(there >= 0, np.arange(_cells(goal)), -1)
    parts = ((1.0, Match(here)), (-1.0, Match(there)))
    taps = ((1.0, here), (-1.0, goal.shift))
    maker.signed("difference", lambda positive: Signed(taps, positive), *parts)
    return {"descattered": ((1.0, "difference"),)}


def _filtered(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
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


def _split(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    """Indirect photos under stripes that light half of all cells, moved by a quarter period.

    Light of one sharp path is there under some stripes and not under others; smooth light is half
    there under all. The mean of all four times 2 has every path, once.
    """
    goal = maker.goal
    period = goal.period or 4
    names = tuple(f"stripes-{step}" for step in range(STRIPES))
    column = np.arange(_cells(goal)) % goal.grid[1]
    for step, name in enumerate(names):
        lit = (column + step * period // STRIPES) % period < period // 2
        parts = ((1.0, Uniform(_cells(goal))), (-1.0, _same(goal)))
        maker.coded(name, Coded(None, True), *parts, light=lit.astype(np.float64))
    return {
        "high": Extremes(1.0, -1.0, names),
        "low": Extremes(0.0, 2.0, names),
        "indirect": tuple((2.0 / STRIPES, name) for name in names),
    }


def _relit(maker: _Maker, white: bool, codes: int) -> dict[str, Rule]:
    """Any matrix A: exact blocks where A has few distinct rows or a low rank, else eq. 9."""
    goal = maker.goal
    matrix = goal.matrices["matrix"]
    light = np.ones(_cells(goal)) if goal.light is None else goal.light
    wanted = Wanted(goal.grid, ((1.0, Full(matrix)),), goal.light)
    distinct, which = np.unique(matrix, axis=0, return_inverse=True)
    answer: dict[str, Rule] = {"relit": ((1.0, "relit"),)}
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


_RECIPES: dict[str, Callable[[_Maker, bool, int], dict[str, Rule]]] = {
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
    "split": _split,
}
