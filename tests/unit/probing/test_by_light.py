"""Scale of photos whose windows smear what they keep: all their light, not what fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdcd.probing.deviation import weight_s
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import Match, Uniform, Wanted
from pdcd.recipes.make import recipe_of
from pdcd.request import How
from tests import dense_recipe

GRID = (4, 8)
CELLS = 32


def test_stripes_that_are_smeared_are_scaled_by_all_their_light() -> None:
    """Half of the time a quarter window sees the stripes moved by half a cell."""
    column = np.arange(CELLS) % GRID[1]
    lit = (column % 4 < 2).astype(float)
    beside = np.where(column > 0, np.roll(lit, 1), lit)
    seconds = 3.0
    smeared = seconds * (0.75 * lit + 0.25 * beside)
    realised = Factors(np.ones((1, CELLS)), smeared[None], smeared.copy(), np.full(CELLS, seconds))
    parts = ((1.0, Uniform(CELLS)), (-1.0, Match(np.arange(CELLS))))
    wanted = Wanted(GRID, parts, lit)
    dense = np.broadcast_to(smeared, (CELLS, CELLS)) * (1.0 - np.eye(CELLS))
    meant = wanted.dense()
    all_light = weight_s(realised, replace(wanted, by_light=True))
    np.testing.assert_allclose(all_light, dense.sum() / meant.sum(), rtol=1e-12)
    fits = float((dense * meant).sum() / (meant**2).sum())
    np.testing.assert_allclose(weight_s(realised, wanted), fits, rtol=1e-2)
    assert fits < 0.9 * all_light


def test_runs_from_before_are_scaled_as_they_were() -> None:
    for goal, more in (("split", {"period": 4}), ("fraction", {"p": 0.25, "shift": (0, 1)})):
        target = dense_recipe.target(GRID, goal, {}, **more)
        for how, scaled in ((How(), False), (How(by_light=True), True)):
            assert {p.wanted.by_light for p in recipe_of(target, how).photos} == {scaled}
    own = dense_recipe.target(GRID, "fraction", {}, p=0.25)
    assert not recipe_of(own, How(by_light=True)).photos[0].wanted.by_light
