"""Which shots, photos and pictures each goal and way of photographing has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.probing.wanted import NearPart, UniformPart
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.each import RECIPES
from pdcd.recipes.goals import Target
from pdcd.recipes.make import finish_recipe, make_draft_recipe, make_recipe
from pdcd.recipes.maker import RecipeMaker, match_own_cells
from pdcd.recipes.programs import (
    CodedProgram,
    ConvolvedProgram,
    FloodlitProgram,
    GainProgram,
    IlluminatedProgram,
    LongRangeProgram,
    SignedProgram,
)
from pdcd.recipes.recipe import Extremes, Recipe

GRID = (4, 8)
N = 32
WARP = np.random.default_rng(0).permutation(N)
PART = np.where(np.arange(N) < 5, -1, WARP)
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


def flags(recipe: Recipe) -> dict[str, tuple[bool, bool, bool, int]]:
    return {
        p.name: (p.wanted.by_direct, p.wanted.by_light, p.row_weights, p.beyond)
        for p in recipe.photos
    }


@pytest.mark.parametrize(
    ("name", "given", "wanted"),
    [
        ("fraction", {"p": 0.25}, {"coded": (True, False, False, 0)}),
        ("fraction", {"p": 0.25, "shift": (0, 1)}, {"coded": (True, True, False, 0)}),
        ("long-range", {"radius": 2}, {"far": (False, False, True, 2)}),
        ("long-range", {"radius": 2, "illumination": LIGHT}, {"far": (False, False, True, 0)}),
        ("descattered", {"shift": (0, 1)}, {"difference": (True, False, False, 0)}),
        ("filtered", {"kernel": np.ones((3, 3))}, {"filtered": (True, False, False, 0)}),
        ("filtered", {"kernel": [[1.0, 0.0, 1.0]]}, {"filtered": (False, False, False, 0)}),
        ("filtered", {"kernel": [[0.0], [1.0], [0.0]]}, {"filtered": (True, False, False, 0)}),
        ("diagonal", {}, {"matched": (False, False, False, 0)}),
    ],
)  # fmt: skip
def test_by_what_light_photos_are_scaled(
    name: str, given: dict[str, Any], wanted: dict[str, Any]
) -> None:
    assert flags(make_recipe(target(name, **given), CaptureScheme())) == wanted


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


def test_white_photos_of_indirect_light_close_the_same_cells() -> None:
    recipe = make_recipe(target("indirect", warp=PART), CaptureScheme())
    white = next(p for p in recipe.photos if p.name == "white").wanted.dense()
    np.testing.assert_array_equal(white, np.outer(PART >= 0, np.ones(N)))
    lit = make_recipe(target("indirect", warp=PART, illumination=LIGHT), CaptureScheme())
    np.testing.assert_allclose(lit.photos[0].wanted.dense(), np.outer(PART >= 0, LIGHT))
    whole = make_recipe(target("indirect", warp=WARP), CaptureScheme())
    assert whole.shots[0].white and whole.shots[0].program == ""
    assert [p.name for p in make_recipe(target("indirect"), CaptureScheme(white=False)).photos] == [
        "coded"
    ]


def test_black_exposures_are_signed_with_the_shot_that_they_belong_to() -> None:
    recipe = make_recipe(target("diagonal"), CaptureScheme(black_level="both"))
    plus = [(s, f"matched-plus{end}") for s, end in zip((1, -1, -1, 1), ENDS, strict=True)]
    minus = [(-s, f"matched-minus{end}") for s, end in zip((1, -1, -1, 1), ENDS, strict=True)]
    assert recipe.photos[0].shots == (*plus, *minus)
    assert [shot.name for shot in recipe.shots] == [name for _, name in (*plus, *minus)]
    black = {s.name.partition("-plus")[2]: (s.primal_black, s.dual_black) for s in recipe.shots[:4]}
    assert list(black.values()) == [(False, False), (False, True), (True, False), (True, True)]


ENDS = ("", "-black-dual", "-black-primal", "-black-primal-dual")


def test_a_maker_puts_light_and_gain_around_a_program() -> None:
    maker = RecipeMaker(target("white", illumination=LIGHT), "none")
    gain = np.linspace(1.0, 0.0, N)
    maker.coded(
        "a",
        LongRangeProgram(1),
        (1.0, UniformPart(N)),
        (-1.0, NearPart(GRID, 1)),
        light=0.5 * LIGHT,
        gain=gain,
    )
    program = maker.programs["a"]
    assert isinstance(program, GainProgram) and isinstance(program.program, IlluminatedProgram)
    (photo,) = maker.photos
    assert (photo.row_weights, photo.beyond) == (True, 0)
    assert photo.wanted.light is not None
    np.testing.assert_allclose(photo.wanted.light, 0.5 * LIGHT**2)
    far = np.ones((N, N)) - NearPart(GRID, 1).rows(0, N)
    np.testing.assert_allclose(photo.wanted.dense(), gain[:, None] * far * 0.5 * LIGHT**2)
    maker.coded("b", CodedProgram(None, True), (1.0, UniformPart(N)), rows=True)
    assert maker.photos[1].row_weights and maker.programs["b"] == maker.programs["b"]
    maker.coded("c", CodedProgram(None, True), (1.0, UniformPart(N)))
    assert not maker.photos[2].row_weights
    maker.say("part", 0.12345, "somehow")
    assert maker.split == ["12.3 % part: somehow"]
    assert RecipeMaker(target("white"), "none").lit(None) is None
    np.testing.assert_array_equal(maker.lit(None), LIGHT)
    np.testing.assert_array_equal(RecipeMaker(target("white"), "none").lit(gain), gain)
    np.testing.assert_array_equal(match_own_cells(maker.target).partner, np.arange(N))


def test_a_white_photo_under_an_illumination_is_one_exact_block() -> None:
    recipe = make_recipe(target("white", illumination=LIGHT), CaptureScheme())
    (shot,) = recipe.shots
    assert (shot.white, shot.program) == (False, "white")
    primal, dual = recipe.programs["white"].pairs(np.zeros((0, N), np.bool_), None)  # type: ignore[arg-type]
    np.testing.assert_array_equal(primal, LIGHT[None])
    np.testing.assert_array_equal(dual, np.ones((1, N)))


def test_shares_of_direct_and_indirect_light() -> None:
    dense = RecipeMaker(target("white"), "none").kept(0.75, 0.25).dense()
    np.testing.assert_allclose(dense, 0.25 + 0.5 * np.eye(N))


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


def test_single_codes_are_masked_for_every_picture() -> None:
    recipe = make_recipe(target("fraction", p=0.25), CaptureScheme(method="multi-image", codes=2))
    assert [(s.name, s.program, s.only) for s in recipe.shots] == [
        ("photo-0001", "photos", 0), ("photo-0002", "photos", 1),
    ]  # fmt: skip
    shares = {n: (s.direct, s.indirect) for n, s in recipe.sums.items() if n != "masked"}  # type: ignore[union-attr]
    assert shares == {
        "fraction": (1.0, 0.25), "white": (1.0, 1.0), "direct": (1.0, 0.0), "indirect": (0.0, 1.0),
    }  # fmt: skip
    assert recipe.pictures == {n: ((1.0, n),) for n in (*shares, "masked")}
    dense = {photo.name: photo.wanted.dense() for photo in recipe.photos}
    for name, (direct, indirect) in {**shares, "masked": (0.0, 1.0)}.items():
        np.testing.assert_allclose(dense[name], indirect + (direct - indirect) * np.eye(N))
    assert recipe.stack == ("photo-0001", "photo-0002")


def test_checkers_tell_by_the_largest_and_the_smallest_photo() -> None:
    recipe = make_recipe(target("fraction", p=0.25), CaptureScheme(method="nayar"))
    names = tuple(f"checker-{k}" for k in range(1, 9))
    assert recipe.pictures == {
        "fraction": Extremes(1.0, 2.0 * 0.25 - 1.0, names),
        "white": tuple((0.25, name) for name in names),
        "direct": Extremes(1.0, -1.0, names),
        "indirect": Extremes(0.0, 2.0, names),
    }
    assert recipe.stack == names and [shot.only for shot in recipe.shots] == list(range(8))
    assert recipe.meant is not None
    np.testing.assert_allclose(recipe.meant.dense(), 0.25 + 0.75 * np.eye(N))
    projector, mask = recipe.programs["checkers"].pairs(np.zeros((0, N), np.bool_), None)  # type: ignore[arg-type]
    assert np.all(mask == 1.0) and mask.shape == projector.shape == (8, N)
    for photo, lit in zip(recipe.photos, projector, strict=True):
        np.testing.assert_array_equal(photo.wanted.dense(), np.outer(np.ones(N), lit))


def test_a_draft_is_finished_by_its_repetitions() -> None:
    how = CaptureScheme(repeat=2)
    draft = make_draft_recipe(target("diagonal"), how)
    assert len(draft.shots) == 2
    assert (
        len(finish_recipe(draft, how).shots) == len(make_recipe(target("diagonal"), how).shots) == 4
    )
