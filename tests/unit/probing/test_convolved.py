"""Filters with many taps mean what a sum of single shifts means."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.panels.lattice import Lattice
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes import each
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.recipe import Recipe

GRID = (5, 7)
CELLS = 35


def recipe(monkeypatch: pytest.MonkeyPatch, many_taps: int) -> Recipe:
    rng = np.random.default_rng(1)
    monkeypatch.setattr(each, "MANY_TAPS", many_taps)
    kernel, light = rng.standard_normal((9, 13)), rng.random(CELLS)
    target = Target(Goal(name="filtered"), GRID, {"illumination": light}, {"kernel": kernel})
    return make_recipe(target, CaptureScheme(codes=16))


def test_a_kernel_over_the_whole_grid_is_the_sum_of_its_taps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    single, whole = recipe(monkeypatch, 10**9), recipe(monkeypatch, 1)
    assert len(single.wanted.parts) == 9 * 13 and len(whole.wanted.parts) == 1
    images = np.random.default_rng(2).random((20, CELLS))
    np.testing.assert_array_equal(whole.wanted.dense(), single.wanted.dense())
    np.testing.assert_array_equal(whole.wanted.diagonal(), single.wanted.diagonal())
    np.testing.assert_allclose(
        whole.wanted.others(images), single.wanted.others(images), atol=1e-12
    )
    np.testing.assert_allclose(whole.wanted.squares(), single.wanted.squares(), atol=1e-12)
    bits = np.random.default_rng(3).random((16, 48)) < 0.5
    for name, program in single.programs.items():
        lattice = Lattice(GRID, "quarter")
        wanted, found = program.pairs(bits, lattice), whole.programs[name].pairs(bits, lattice)
        np.testing.assert_array_equal(found[0], wanted[0])
        np.testing.assert_allclose(found[1], wanted[1], atol=1e-14)
