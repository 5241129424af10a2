"""What can be made of the shots that are there, and what is taken more than once."""

from __future__ import annotations

from typing import Any

import pytest

from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe, narrow_to_shots
from pdcd.recipes.parts import repeat_shots
from pdcd.recipes.recipe import Recipe

GRID = (4, 8)


def recipe(name: Any = "indirect", period: int | None = None, **how: Any) -> Recipe:
    return make_recipe(Target(Goal(name=name, period=period), GRID), CaptureScheme(**how))


def terms(found: Recipe) -> dict[str, list[str]]:
    return {p.name: [f"{'+' if s > 0 else '-'}{n}" for s, n in p.shots] for p in found.photos}


def test_photos_are_there_when_their_shots_are() -> None:
    whole = recipe()
    found = narrow_to_shots(whole, {"white"})
    assert terms(found) == {"white": ["+white"]}
    assert list(found.pictures) == ["white"] and [s.name for s in found.shots] == ["white"]
    found = narrow_to_shots(whole, {"coded"})
    assert terms(found) == {"coded": ["+coded"]} and list(found.pictures) == ["indirect"]
    assert narrow_to_shots(whole, {"white", "coded"}) == whole
    nothing = narrow_to_shots(whole, set())
    assert (nothing.photos, nothing.shots, nothing.pictures) == ((), (), {})


def test_black_exposures_are_done_without_where_one_is_missing() -> None:
    whole = recipe(white=False, black_level="both")
    lit, dual, primal, both = (shot.name for shot in whole.shots)
    assert terms(narrow_to_shots(whole, {lit, dual, primal, both})) == {
        "coded": [f"+{lit}", f"-{dual}", f"-{primal}", f"+{both}"]
    }
    assert terms(narrow_to_shots(whole, {lit, dual, primal})) == {"coded": [f"+{lit}"]}
    assert terms(narrow_to_shots(whole, {dual, primal, both})) == {}


def test_repeated_shots_are_taken_as_often_as_all_of_a_photo_are() -> None:
    whole = recipe("diagonal", repeat=3)
    plus, minus = "matched-plus", "matched-minus"
    every = {shot.name for shot in whole.shots}
    assert every == {f"{n}{c}" for n in (plus, minus) for c in ("", "-2", "-3")}
    assert terms(narrow_to_shots(whole, every - {f"{minus}-3"})) == {
        "matched": [f"+{plus}", f"+{plus}-2", f"-{minus}", f"-{minus}-2"]
    }
    assert terms(narrow_to_shots(whole, {plus, f"{plus}-2", f"{minus}-3"})) == {
        "matched": [f"+{plus}", f"-{minus}-3"]
    }
    assert terms(narrow_to_shots(whole, {plus, f"{plus}-2"})) == {}


def test_extremes_want_all_of_their_photos() -> None:
    whole = recipe("split", period=4)
    names = [shot.name for shot in whole.shots]
    assert narrow_to_shots(whole, set(names[:-1])).pictures == {}
    assert list(narrow_to_shots(whole, set(names)).pictures) == ["high", "low", "indirect"]


def test_sums_want_all_of_their_stack() -> None:
    whole = recipe(method="multi-image", codes=3)
    assert narrow_to_shots(whole, set(whole.stack)).pictures == whole.pictures
    assert narrow_to_shots(whole, set(whole.stack[:2])).pictures == {}


def test_only_shots_that_the_answer_rests_on_are_repeated() -> None:
    single = recipe(black_level="mask", codes=16, pilot=2)
    found = repeat_shots(single, 3)
    assert repeat_shots(single, 1) is single
    assert [shot.name for shot in found.shots] == [
        "white", "white-black-dual", "pilot-0001", "pilot-0002", "coded", "coded-2", "coded-3",
        "coded-black-dual", "coded-black-dual-2", "coded-black-dual-3",
    ]  # fmt: skip
    assert {s.name: s.copy_of for s in found.shots if s.copy_of} == {
        "coded-2": "coded", "coded-3": "coded", "coded-black-dual-2": "coded-black-dual",
        "coded-black-dual-3": "coded-black-dual",
    }  # fmt: skip
    assert terms(found)["coded"] == [
        "+coded", "+coded-2", "+coded-3",
        "-coded-black-dual", "-coded-black-dual-2", "-coded-black-dual-3",
    ]  # fmt: skip
    assert terms(found)["white"] == ["+white", "-white-black-dual"]


@pytest.mark.parametrize("count", [2, 4])
def test_every_photo_of_extremes_is_repeated(count: int) -> None:
    found = repeat_shots(recipe("split", period=4), count)
    assert len(found.shots) == 4 * count
    assert all(len(photo.shots) == count for photo in found.photos)
