"""Shots of codes that come after others which count no more."""

from __future__ import annotations

from typing import Any

import pytest

from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.recipe import Recipe

HOW: list[dict[str, Any]] = [
    {"codes": 40, "pilot": 16, "black_level": "ambient"},
    {"codes": 64, "pilot": 16, "parts": 4, "black_level": "both"},
    {"codes": 40, "pilot": 16, "repeat": 3, "black_level": "ambient"},
]


def recipe(name: Any, **how: Any) -> Recipe:
    return make_recipe(Target(Goal(name=name), (4, 8)), CaptureScheme(**how))


@pytest.mark.parametrize("goal", ["indirect", "direct"])
@pytest.mark.parametrize("how", HOW)
def test_shots_of_codes_have_names_of_their_own(goal: str, how: dict[str, Any]) -> None:
    before, late = recipe(goal, **how), recipe(goal, **how, late=True)
    new = {b.name: a.name for b, a in zip(before.shots, late.shots, strict=True)}
    assert len(set(new.values())) == len(new)
    for old in before.shots:
        kept = old.white or old.name in before.stack
        assert new[old.name] == (old.name if kept else f"{old.name}-late")
    assert not {s.name for s in late.shots if s.name.endswith("-late")} & set(new)
    # All else is the same, and speaks of the shots by these names.
    assert (late.stack, late.programs.keys()) == (before.stack, before.programs.keys())
    for one, other in zip(before.photos, late.photos, strict=True):
        assert other.shots == tuple((sign, new[name]) for sign, name in one.shots)
    for was, now in zip(before.shots, late.shots, strict=True):
        assert (was.program, was.part, was.kind) == (now.program, now.part, now.kind)
        assert now.copy_of == (new[was.copy_of] if was.copy_of else "")
