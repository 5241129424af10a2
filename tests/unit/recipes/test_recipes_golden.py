"""Recipes show what they did, and matrices come apart as they did, when benchmarks were taken.

`tests/data/recipes.json` has what each goal's programs send to the panels, what its photos are to
hold, and what matrices of some kinds are taken apart into. Where one is changed on purpose, write
it anew by ``python -m tests.unit.recipes.test_recipes_golden``, and measure again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.panels.lattice import Lattice
from pdcd.probing.wanted import NearPart, shift_cells
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.alternatives import CodeMixture, FittedWeights, MaskedWeights, make_checkers
from pdcd.recipes.even import find_even_part
from pdcd.recipes.factored import factor_matrix, find_nonnegative_sides
from pdcd.recipes.goals import Target, check_target
from pdcd.recipes.isolation import Isolation
from pdcd.recipes.make import make_recipe
from pdcd.recipes.off_axis import choose_comb_period
from pdcd.recipes.partners import link_partners
from pdcd.recipes.recipe import Recipe
from pdcd.recipes.structure import find_structure
from pdcd.recipes.transport import count_slice_photos, make_s_matrix
from tests.golden import alike, keep, kept_in, plain
from tests.places import DATA

GOLDEN = DATA / "recipes.json"
GRID = (6, 8)
N = 48
Floats = NDArray[np.float64]
RNG = np.random.default_rng(31)
LIGHT = 0.25 + 0.75 * RNG.random(N)
WARP = RNG.permutation(N)
PART = np.where(RNG.random(N) < 0.2, -1, WARP)
REGION = (RNG.random(N) < 0.5).astype(float)
KERNEL = RNG.standard_normal((3, 5))
TILT = (1.0, 0.05, -0.02, 0.0, 1.0, 0.01, 0.02, 0.0, 1.0)

GOALS: dict[str, tuple[str, dict[str, Any]]] = {
    "white": ("white", {}),
    "white, lit": ("white", {"illumination": LIGHT}),
    "indirect": ("indirect", {}),
    "indirect, lit": ("indirect", {"illumination": LIGHT, "warp": PART}),
    "indirect, shift": ("indirect", {"shift": (1, -2)}),
    "direct": ("direct", {"warp": WARP}),
    "fraction": ("fraction", {"p": 0.25}),
    "fraction, shift": ("fraction", {"p": 0.3, "shift": (0, 1)}),
    "illuminated": ("illuminated", {"illumination": LIGHT}),
    "diagonal": ("diagonal", {}),
    "off-diagonal": ("off-diagonal", {"shift": (0, -3)}),
    "off-diagonal, p": ("off-diagonal", {"shift": (2, 1), "p": 0.5}),
    "warped": ("warped", {"warp": PART}),
    "two-samples": ("two-samples", {"warp": WARP, "warp_b": PART, "mix": (0.75, -2.0)}),
    "long-range": ("long-range", {"radius": 1}),
    "short-range": ("short-range", {"radius": 2}),
    "blocked": ("blocked", {"region_a": REGION, "region_b": 1.0 - REGION}),
    "blocked, lit": (
        "blocked", {"region_a": REGION, "region_b": REGION, "illumination": LIGHT}
    ),
    "descattered": ("descattered", {"shift": (0, -1)}),
    "filtered": ("filtered", {"kernel": KERNEL}),
    "split": ("split", {"period": 4, "illumination": LIGHT}),
    "keyed": ("keyed", {}),
    "keyed, range": ("keyed", {"disparity": (-1, 1)}),
    "keyed, plane": ("keyed", {"plane": TILT, "disparity": (0, 1)}),
    "keyed, map": ("keyed", {"disparities": np.linspace(-2.0, 2.0, N), "disparity": (1, 1)}),
    "stereo": ("stereo", {"warp": PART, "disparity": (0, 1)}),
    "epipolar": ("epipolar", {"keep": "in"}),
    "epipolar, out": ("epipolar", {"keep": "out"}),
    "transport": ("transport", {"rows": (1, 4)}),
    "transport, masked": ("transport", {"rows": (2, 2), "masked": True}),
    "relit": ("relit", {"matrix": RNG.standard_normal((N, N))}),
    "relit, rows": ("relit", {"matrix": RNG.random((5, N))[np.arange(N) % 5]}),
    "relit, rank": ("relit", {"matrix": RNG.random((N, 2)) @ RNG.standard_normal((2, N))}),
}  # fmt: skip
MATRICES = ("matrix", "kernel")
UNTOLD = "relit, rank"
"""Two patterns times two: turned into each other they do as well, and which come out hangs on the
library. `test_composed` has their product."""


def target(name: str, given: dict[str, Any]) -> Target:
    arrays = {k: np.asarray(v, float) for k, v in given.items() if isinstance(v, np.ndarray)}
    numbers = {k: v for k, v in given.items() if k not in arrays}
    goal = Goal(name=name, **numbers)  # type: ignore[arg-type]
    planes = {k: v for k, v in arrays.items() if k not in MATRICES}
    return check_target(
        Target(goal, GRID, planes, {k: v for k, v in arrays.items() if k in MATRICES})
    )


def shown(recipe: Recipe) -> Iterator[Any]:
    for name, program in recipe.programs.items():
        yield name, program.coded, program.p
        for window in ("whole", "quarter") if program.coded else ("whole",):
            lattice = Lattice(GRID, window)
            bits = np.random.default_rng(32).random((64, lattice.lattice_cells)) < program.p
            yield [side.astype(np.float64) for side in program.pairs(bits, lattice)]


def told(recipe: Recipe, *, panels: bool = True) -> Any:
    photos = [
        [p.name, p.shots, p.row_weights, p.beyond, p.wanted.by_direct, p.wanted.by_light,
         p.wanted.dense()]
        for p in recipe.photos
    ]  # fmt: skip
    shots = [dataclasses.astuple(shot) for shot in recipe.shots]
    rules = {name: repr(rule) for name, rule in recipe.pictures.items()}
    seen = list(shown(recipe)) if panels else []
    return [photos, shots, rules, recipe.stack, seen, recipe.split]


def goals() -> Any:
    made = {}
    for name, (goal, given) in GOALS.items():
        for black in ("none", "both"):
            if goal != "transport" or black == "none":
                how = CaptureScheme(codes=64, black_level=black)
                recipe = make_recipe(target(goal, given), how)
                made[f"{name}, {black}"] = told(recipe, panels=name != UNTOLD)
    return made


def ways() -> Any:
    indirect, fraction = target("indirect", {}), target("fraction", {"p": 0.25})
    made = {
        "multi-image": told(make_recipe(fraction, CaptureScheme(method="multi-image", codes=4))),
        "nayar": told(make_recipe(fraction, CaptureScheme(method="nayar"))),
        "pilot": told(make_recipe(indirect, CaptureScheme(codes=16, pilot=4))),
        "all pilot": told(make_recipe(indirect, CaptureScheme(codes=8, pilot=8))),
        "parts": told(make_recipe(indirect, CaptureScheme(codes=16, parts=4, black_level="mask"))),
        "repeated": told(make_recipe(indirect, CaptureScheme(codes=16, repeat=3))),
        "pairs": told(make_recipe(indirect, CaptureScheme(codes=16, method="pairs"))),
        "keyed alone": told(make_recipe(target("keyed", {}), CaptureScheme(codes=16, white=False))),
        "rows alone": told(
            make_recipe(target("epipolar", {"keep": "in"}), CaptureScheme(codes=16, white=False))
        ),
    }
    recipe = make_recipe(target("diagonal", {}), CaptureScheme(codes=16))
    for confocal in (False, True):
        for positive in (False, True):
            isolation = Isolation(recipe.photos[0].wanted, positive, confocal)
            sides = isolation.pairs(np.zeros((0, N), np.bool_), Lattice(GRID))
            made[f"isolation, {confocal}, {positive}"] = [
                isolation.count(), *[side.astype(np.float64) for side in sides]
            ]  # fmt: skip
    rng = np.random.default_rng(33)
    lit = rng.random((4, 5))
    seen = CodeMixture(12, 6.0 * lit, 3.5 * lit**2, np.round(3.0 * lit))
    made["mixed"] = [
        MaskedWeights().mixed(lit - 0.5, seen),
        FittedWeights(1.0, 0.25).mixed(lit, seen),
    ]
    made["checkers"] = [make_checkers((5, 7)), make_checkers((4, 4), 3)]
    made["photos of a slice"] = [count_slice_photos(cells) for cells in range(1, 120)]
    made["s-matrix"] = make_s_matrix(20).astype(float)
    made["periods"] = [
        choose_comb_period(c, 32, d) for c in (8, 33, 64, 128, 256) for d in (2, 3, 5)
    ]
    links = link_partners((WARP, (0, 5)), Lattice(GRID, "quarter"))
    assert links is not None
    made["links"] = links.toarray()
    return made


def matrices(grid: tuple[int, int], seed: int) -> dict[str, Floats]:
    """Matrices of many kinds, with and without noise on their numbers."""
    rng = np.random.default_rng(seed)
    cells = grid[0] * grid[1]
    ones, eye = np.ones((cells, cells)), np.eye(cells)
    warp = eye[rng.permutation(cells)]
    near = NearPart(grid, 1).rows(0, cells)
    partner = shift_cells(grid, (1, 2))
    shift = np.zeros((cells, cells))
    shift[partner >= 0, partner[partner >= 0]] = 1.0
    gain, light = 0.1 + rng.random(cells), 0.1 + rng.random(cells)
    low = rng.random((cells, 3)) @ rng.random((3, cells))
    found = {
        "all but one": ones - eye,
        "part": 2.0 * ones - 0.7 * warp,
        "more": ones + 3.0 * eye,
        "band": ones - near,
        "two bands": 2.0 * ones + near + 0.5 * NearPart(grid, 2).rows(0, cells),
        "matches": 0.75 * warp - 0.5 * shift,
        "gain": gain[:, None] * (ones - warp) * light,
        "sum": low - 0.5 * warp + 0.5 * near + shift,
        "both signs": rng.standard_normal((cells, 2)) @ rng.standard_normal((2, cells)),
        "anything": rng.standard_normal((cells, cells)),
    }
    noise = rng.standard_normal((cells, cells))
    found |= {f"{name}, noisy": one + 1e-3 * noise for name, one in list(found.items())[:3]}
    return found


LARGE = ("part", "sum", "all but one, noisy")
"""Of more cells than a look at some of them takes."""


def apart() -> Any:
    made: dict[str, Any] = {}
    for grid, seed in (((9, 12), 34), ((14, 15), 35)):
        for name, matrix in matrices(grid, seed).items():
            if grid != (9, 12) and name not in LARGE:
                continue
            found = find_structure(matrix, grid)
            even = find_even_part(matrix)
            sides = (
                found.gain, found.light, found.level, found.near,
                [[weight, partner] for weight, partner in found.matches],
                None if found.rest is None else float(f"{np.abs(found.rest).sum():.5g}"),
                len(found.camera), None if even is None else len(even[0]),
                factor_matrix(matrix, 4) is not None,
            )  # fmt: skip
            made[f"{grid}, {name}"] = [_coarse(side) for side in sides]
            if grid == (9, 12) and "noisy" not in name:
                goal = Target(Goal(name="relit"), grid, {}, {"matrix": matrix})
                recipe = make_recipe(goal, CaptureScheme(codes=64))
                made[f"{grid}, {name}, said"] = [
                    recipe.split, [shot.name for shot in recipe.shots],
                    [[n, _coarse(float(w))] for w, n in recipe.pictures["relit"]],  # type: ignore[union-attr]
                ]  # fmt: skip
    rng = np.random.default_rng(36)
    for rank in (1, 2, 3):
        seen, lit = (rng.random((rank, 60)) * (rng.random((rank, 60)) < 0.7) for _ in range(2))
        mix = rng.standard_normal((rank, rank))
        found_sides = find_nonnegative_sides(
            np.asarray(np.linalg.solve(mix.T, seen), float), mix @ lit
        )
        made[f"sides of rank {rank}"] = found_sides is not None
    return made


def _coarse(value: Any) -> Any:
    """To five digits: what a fit ends at depends on the last ones."""
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        return np.round(value, 5) + 0.0
    return float(f"{value:.5g}") if isinstance(value, float) else value


MADE: dict[str, Callable[[], Any]] = {"goals": goals, "ways": ways, "apart": apart}


@pytest.mark.parametrize("name", list(MADE))
def test_recipes_are_what_they_were(name: str) -> None:
    alike(plain(MADE[name]()), kept_in(GOLDEN)[name], name)


if __name__ == "__main__":
    keep(GOLDEN, {name: plain(make()) for name, make in MADE.items()})
