"""Scale of photos whose windows smear what they keep: their light, not what fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdcd.probing.deviation import weight_s
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import MatchPart, UniformPart, WantedMatrix
from pdcd.protocol.plan_summary import CaptureScheme
from pdcd.recipes.make import make_recipe
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
    parts = ((1.0, UniformPart(CELLS)), (-1.0, MatchPart(np.arange(CELLS))))
    wanted = WantedMatrix(GRID, parts, lit)
    dense = np.broadcast_to(smeared, (CELLS, CELLS)) * (1.0 - np.eye(CELLS))
    meant = wanted.dense()
    all_light = weight_s(realised, replace(wanted, by_light=True))
    np.testing.assert_allclose(all_light, dense.sum() / meant.sum(), rtol=1e-12)
    fits = float((dense * meant).sum() / (meant**2).sum())
    np.testing.assert_allclose(weight_s(realised, wanted), fits, rtol=1e-2)
    assert fits < 0.9 * all_light


def test_direct_light_less_that_of_a_neighbour_is_scaled_by_the_direct_light() -> None:
    """Light of the matched cell comes from around it, too; direct light is as long as it was."""
    seconds = 3.0
    own, beside = np.arange(CELLS), np.roll(np.arange(CELLS), 1)
    there = np.zeros((CELLS, CELLS))
    for weight, cells in ((-0.5, beside), (-0.25, np.roll(own, 2)), (0.25, beside)):
        there[own, cells] += seconds * weight
    realised = Factors(np.eye(CELLS), there, np.full(CELLS, seconds), np.full(CELLS, seconds))
    wanted = WantedMatrix(GRID, ((1.0, MatchPart(own)), (-1.0, MatchPart(beside))))
    np.testing.assert_allclose(weight_s(realised, replace(wanted, by_direct=True)), seconds)
    fits = float(np.sum((there + seconds * np.eye(CELLS)) * wanted.dense()) / (2 * CELLS))
    np.testing.assert_allclose(weight_s(realised, wanted), fits)
    assert fits < 0.7 * seconds


def test_stripes_and_matched_cells_with_a_share_of_the_rest_are_scaled_by_all_their_light() -> None:
    for goal, numbers, scaled in (
        ("split", {"period": 4}, True),
        ("fraction", {"p": 0.25, "shift": (0, 1)}, True),
        ("fraction", {"p": 0.25}, False),
    ):
        target = dense_recipe.target(GRID, goal, {}, **numbers)
        assert {p.wanted.by_light for p in make_recipe(target, CaptureScheme()).photos} == {scaled}
