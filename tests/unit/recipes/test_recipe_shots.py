"""Which shots, photos and pictures each goal and way of photographing has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.each import RECIPES
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.programs import (
    ConvolvedProgram,
    FloodlitProgram,
    SignedProgram,
)
from pdcd.recipes.recipe import Extremes

GRID = (4, 8)
N = 32
WARP = np.random.default_rng(0).permutation(N)
LIGHT = np.linspace(0.25, 1.0, N)


def target(name: str, **given: Any) -> Target:
    planes = {k: np.asarray(v, float) for k, v in given.items() if k in PLANES}
    matrices = {k: np.asarray(v, float) for k, v in given.items() if k in ("matrix", "kernel")}
    numbers = {k: v for k, v in given.items() if k not in planes and k not in matrices}
    return Target(Goal(name=name, **numbers), GRID, planes, matrices)  # type: ignore[arg-type]


PLANES = ("illumination", "warp", "warp_b", "region_a", "region_b")
ONE = {"region_a": np.ones(N), "region_b": np.ones(N)}

PICTURES: list[tuple[str, dict[str, Any], dict[str, Any], list[str]]] = [
    ("white", {}, {"white": ((1.0, "white"),)}, ["white"]),
    (
        "indirect", {},
        {"indirect": ((1.0, "coded"),), "white": ((1.0, "white"),),
         "direct": ((1.0, "white"), (-1.0, "coded"))},
        ["white", "coded"],
    ),
    (
        "direct", {},
        {"direct": ((1.0, "white"), (-1.0, "coded")), "white": ((1.0, "white"),),
         "indirect": ((1.0, "coded"),)},
        ["white", "coded"],
    ),
    ("fraction", {"p": 0.25}, {"fraction": ((1.0, "coded"),)}, ["coded"]),
    ("illuminated", {"illumination": LIGHT}, {"illuminated": ((1.0, "white"),)}, ["white"]),
    ("diagonal", {}, {"diagonal": ((1.0, "matched"),)}, ["matched-plus", "matched-minus"]),
    ("off-diagonal", {"shift": (0, 1)}, {"off-diagonal": ((1.0, "matched"),)},
     ["matched-plus", "matched-minus"]),
    ("off-diagonal", {"shift": (0, 1), "p": 0.5}, {"off-diagonal": ((1.0, "coded"),)}, ["coded"]),
    ("warped", {"warp": WARP}, {"warped": ((1.0, "matched"),)}, ["matched-plus", "matched-minus"]),
    ("two-samples", {"warp": WARP, "warp_b": WARP, "mix": (0.75, -2.0)},
     {"two-samples": ((0.75, "first"), (-2.0, "second"))},
     ["first-plus", "first-minus", "second-plus", "second-minus"]),
    ("long-range", {"radius": 2}, {"long-range": ((1.0, "far"),)}, ["far"]),
    ("short-range", {"radius": 2},
     {"short-range": ((1.0, "coded"), (-1.0, "far")), "indirect": ((1.0, "coded"),),
      "long-range": ((1.0, "far"),)}, ["coded", "far"]),
    ("blocked", ONE, {"blocked": ((1.0, "blocked"),)}, ["blocked"]),
    ("descattered", {"shift": (0, 1)}, {"descattered": ((1.0, "difference"),)},
     ["difference-plus", "difference-minus"]),
    ("filtered", {"kernel": np.ones((3, 3))}, {"filtered": ((1.0, "filtered"),)},
     ["filtered-plus", "filtered-minus"]),
]  # fmt: skip


@pytest.mark.parametrize(("name", "given", "pictures", "shots"), PICTURES)
def test_pictures_of_a_goal(
    name: str, given: dict[str, Any], pictures: dict[str, Any], shots: list[str]
) -> None:
    recipe = make_recipe(target(name, **given), CaptureScheme())
    assert recipe.pictures == pictures and list(recipe.pictures) == list(pictures)
    assert [shot.name for shot in recipe.shots] == shots
    assert recipe.answer_name == name and recipe.answer == pictures[name]
    assert name in RECIPES


def test_stripes_move_by_a_quarter_of_their_period() -> None:
    recipe = make_recipe(target("split", period=8), CaptureScheme())
    names = tuple(f"stripes-{k}" for k in range(4))
    assert recipe.pictures == {
        "high": Extremes(1.0, -1.0, names),
        "low": Extremes(0.0, 2.0, names),
        "indirect": tuple((0.5, name) for name in names),
    }
    for step, photo in enumerate(recipe.photos):
        lit = [((col + 2 * step) % 8) < 4 for col in range(8)] * 4
        np.testing.assert_array_equal(photo.wanted.light, np.array(lit, float))
        assert photo.wanted.by_light
    assert recipe.main == "stripes-3"
    with pytest.raises(RequestError, match="no sum of photos"):
        _ = recipe.wanted


@pytest.mark.parametrize(("taps", "kind"), [(255, SignedProgram), (256, ConvolvedProgram)])
def test_kernels_of_very_many_taps_are_convolved(taps: int, kind: type) -> None:
    kernel = np.zeros((17, 17))
    kernel.ravel()[:taps] = 1.0
    recipe = make_recipe(target("filtered", kernel=kernel), CaptureScheme())
    assert {type(p) for p in recipe.programs.values()} == {kind}


def test_a_pilot_comes_before_the_coded_shots() -> None:
    recipe = make_recipe(target("indirect"), CaptureScheme(codes=12, pilot=3))
    pilots = [f"pilot-{k:04d}" for k in (1, 2, 3)]
    assert [shot.name for shot in recipe.shots] == ["white", *pilots, "coded"]
    assert [shot.only for shot in recipe.shots] == [None, 0, 1, 2, None]
    assert recipe.stack == tuple(pilots) and not recipe.sums
    assert isinstance(recipe.programs["pilot"], FloodlitProgram)
    for wrong in ("fraction", "diagonal"):
        with pytest.raises(RequestError, match="takes no pilot"):
            make_recipe(
                target(wrong, p=0.5 if wrong == "fraction" else None), CaptureScheme(pilot=3)
            )
    with pytest.raises(RequestError, match="neither a shift nor a warp"):
        make_recipe(target("indirect", shift=(0, 1)), CaptureScheme(pilot=3))


def test_a_pilot_of_all_codes_is_masked_in_software() -> None:
    all_codes = CaptureScheme(codes=8, pilot=8)
    assert all_codes.coded == 0
    for name in ("indirect", "direct"):
        recipe = make_recipe(target(name), all_codes)
        assert "coded" not in recipe.programs and "coded" not in [s.name for s in recipe.shots]
        assert recipe.sums["coded"].direct == 0.0  # type: ignore[union-attr]
        assert recipe.sums["coded"].indirect == 1.0  # type: ignore[union-attr]
    with pytest.raises(RequestError, match="leaves no codes for the goal short-range"):
        make_recipe(target("short-range", radius=1), all_codes)
    for how, given in (
        (CaptureScheme(codes=8, pilot=8, black_level="mask"), {}),
        (all_codes, {"illumination": LIGHT}),
    ):
        with pytest.raises(RequestError, match="neither black exposures nor an illumination"):
            make_recipe(target("indirect", **given), how)
