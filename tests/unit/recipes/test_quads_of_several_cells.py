"""Weights of quads that see several cells, where single codes are masked in software."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.protocol.plan_summary import Goal
from pdcd.recipes.alternatives import (
    ALL_DARK,
    CodeMixture,
    FittedWeights,
    MaskedWeights,
    compute_masked_weights,
    find_light_shares,
    fit_weights,
)
from pdcd.recipes.goals import Target

COUNT = 12


def mixture(lit: np.ndarray, spread: float | None = None, dark: float = 3.0) -> CodeMixture:
    """Of quads whose lit shares were `lit` in each of the photos, (K, n)."""
    squares = np.sum(lit**2, axis=0)
    if spread is not None:
        squares = np.sum(lit, axis=0) ** 2 / len(lit) + spread
    return CodeMixture(len(lit), np.sum(lit, axis=0), squares, np.full(lit.shape[1], dark))


@pytest.mark.parametrize(
    ("lit", "weight"), [(0.0, 2.0), (0.999 * ALL_DARK, 2.0), (ALL_DARK, 0.0), (0.5, 0.0)]
)
def test_a_quad_counts_where_all_that_it_sees_is_dark(lit: float, weight: float) -> None:
    """As much in all as if that were half of the photos: of twelve, here in three of them."""
    seen = mixture(np.zeros((COUNT, 1)))
    assert MaskedWeights().mixed(np.array([lit]), seen) == weight
    assert MaskedWeights().mixed(np.array([lit]), mixture(np.zeros((COUNT, 1)), dark=0.0)) == 0.0


@pytest.mark.parametrize(("direct", "indirect"), [(1.0, 0.0), (0.0, 1.0), (1.0, 0.25)])
def test_a_quad_that_sees_one_cell_has_its_weights(direct: float, indirect: float) -> None:
    bits = np.random.default_rng(0).random((COUNT, 7)) < 0.5
    lit = bits.astype(float)
    how = FittedWeights(direct, indirect)
    cells = fit_weights(bits, direct=direct, indirect=indirect)
    np.testing.assert_array_equal(how(bits), cells)
    found = np.stack([how.mixed(lit[k], mixture(lit)) for k in range(COUNT)])
    np.testing.assert_allclose(found, cells, atol=1e-12)
    np.testing.assert_array_equal(MaskedWeights()(bits), compute_masked_weights(bits))


def test_a_line_through_shares_between_dark_and_lit() -> None:
    """Light in proportion to the share: direct is its slope, indirect twice its value at 0."""
    lit = np.random.default_rng(1).random((COUNT, 5))
    photos = 0.3 + 0.8 * lit
    for how, wanted in (
        (FittedWeights(1.0, 0.0), 0.8),
        (FittedWeights(0.0, 1.0), 0.6),
        (FittedWeights(1.0, 0.5), 1.1),
    ):
        weights = np.stack([how.mixed(one, mixture(lit)) for one in lit])
        np.testing.assert_allclose(np.sum(weights * photos, axis=0), wanted)


def test_quads_that_hardly_change_tell_nothing() -> None:
    lit = np.full((COUNT, 1), 0.5)
    for spread, told in ((ALL_DARK, False), (1.01 * ALL_DARK, True)):
        found = FittedWeights(1.0, 1.0).mixed(np.array([0.7]), mixture(lit, spread))
        assert bool(found.any()) == told


def test_shares_of_every_goal_that_has_them() -> None:
    for name, p, wanted in (
        ("direct", None, (1.0, 0.0)), ("indirect", None, (0.0, 1.0)), ("fraction", 0.3, (1.0, 0.3)),
    ):  # fmt: skip
        goal = Goal(name=name, p=p)  # type: ignore[arg-type]
        assert find_light_shares(Target(goal, (4, 8)), "nayar") == wanted
