"""Photos in parts: which shots there are, which codes they get, what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.codes.make import make_codes
from pdcd.errors import RequestError
from pdcd.planning.make import make_plan
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.parts import (
    count_part_codes,
    derive_part_seed,
    list_parts,
    randomise_signs,
    select_complete_parts,
    select_parts,
    split_into_parts,
)
from tests import bench_rig

GRID = (3, 4)


def test_each_part_takes_every_shot_of_codes_in_turn() -> None:
    recipe = split_into_parts(
        make_recipe(Target(Goal(name="indirect"), GRID), CaptureScheme(black_level="mask")), 2
    )
    assert [shot.name for shot in recipe.shots] == [
        "white",
        "white-black-dual",
        "coded-1",
        "coded-1-black-dual",
        "coded-2",
        "coded-2-black-dual",
    ]
    coded = recipe.coded
    assert coded is not None
    assert coded.shots == (
        (1.0, "coded-1"),
        (-1.0, "coded-1-black-dual"),
        (1.0, "coded-2"),
        (-1.0, "coded-2-black-dual"),
    )
    assert set(recipe.programs) == {"coded-1", "coded-2"}
    assert {shot.kind for shot in recipe.shots} == {"", "coded"}


def test_both_halves_of_a_signed_photo_belong_to_one_part() -> None:
    recipe = split_into_parts(make_recipe(Target(Goal(name="diagonal"), GRID), CaptureScheme()), 2)
    second = select_parts(recipe, {2})
    assert second.photos[0].shots == ((1.0, "matched-plus-2"), (-1.0, "matched-minus-2"))


def test_only_complete_parts_are_taken() -> None:
    recipe = split_into_parts(make_recipe(Target(Goal(name="diagonal"), GRID), CaptureScheme()), 3)
    names = [shot.name for shot in recipe.shots]
    assert list_parts(select_complete_parts(recipe, names[:5])) == (1, 2)
    assert select_complete_parts(recipe, names[:1]) is recipe


def test_no_two_parts_share_a_seed() -> None:
    seeds = [derive_part_seed(seed, 8, part) for seed in range(20) for part in range(1, 9)]
    assert len(set(seeds)) == len(seeds)
    assert derive_part_seed(7, 1, 0) == 7


def weight_of_near_neighbours(*, coins: bool, runs: int = 200) -> float:
    """Mean realised weight over the wanted one of cells 2 to 3 cells away, over seeds."""
    shape, count, centre = (12, 12), 8, 6 * 12 + 6
    row, col = np.indices(shape)
    away = np.hypot(row - 6, col - 6).ravel()
    weights = []
    for seed in range(runs):
        codes = make_codes("hadamard", shape, count, dual="complement", seed=seed).primal
        lit = randomise_signs(codes, seed) if coins else codes
        assert np.all(lit.sum(axis=0) == count // 2)
        met = np.count_nonzero(~lit[:, [centre]] & lit, axis=0)
        weights.append(4.0 / count * np.mean(met[(away >= 2.0) & (away < 3.0)]))
    return float(np.mean(weights))


@pytest.mark.long
def test_coins_take_the_common_error_out_of_parts() -> None:
    """The mean over 200 seeds has a standard error of 0.007."""
    assert weight_of_near_neighbours(coins=False) > 1.05
    assert weight_of_near_neighbours(coins=True) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(
    ("request_", "what"),
    [
        (CaptureRequest(goal="white", codes=8, parts=2), "no coded photo"),
        (CaptureRequest(goal="indirect", codes=30, parts=4), "take 28 codes"),
        (CaptureRequest(goal="indirect", codes=24, parts=4), "K = 6"),
        (CaptureRequest(goal="indirect", codes=8, parts=2, until_error=0.1), "at least 4 parts"),
        (CaptureRequest(goal="indirect", parts=4, family="isolation"), "no codes to split"),
    ],
)
def test_refusals(request_: CaptureRequest, what: str, tmp_path: Path) -> None:
    with pytest.raises(RequestError) as caught:
        make_plan(request_, bench_rig.config(tmp_path), GRID)
    assert what in str(caught.value)


def test_too_few_codes_for_the_parts_name_a_number_that_works() -> None:
    with pytest.raises(RequestError, match="take 8 codes"):
        count_part_codes(3, 8)
