"""What is done without a mask, against dense matrices and the formulas of the paper."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.errors import RequestError
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.alternatives import (
    ALL_DARK,
    CodeMixture,
    FittedWeights,
    MaskedWeights,
    make_checkers,
)
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
GRID = (4, 8)
N = 32


def transport(seed: int = 3) -> Floats:
    rng = np.random.default_rng(seed)
    return np.asarray(0.02 * rng.random((N, N)) + np.diag(0.3 + rng.random(N)))


def codes(family: str, count: int, seed: int = 0) -> Bools:
    return make_codes(family, GRID, count, dual="same", seed=seed).primal


def weighted(weights: Floats, bits: Bools, t: Floats) -> Floats:
    """Sum over photos ``T i_k`` of single codes, written out."""
    image = np.zeros(N)
    for k in range(len(bits)):
        for n in range(N):
            image[n] += weights[k, n] * sum(t[n, m] for m in range(N) if bits[k, m])
    return image


def random_bits(rng: np.random.Generator, count: int) -> Bools:
    return np.asarray(rng.random((count, N)) < 0.5)


@pytest.mark.parametrize(("direct", "indirect"), [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.3)])
def test_hadamard_photos_are_exact_with_more_codes_than_cells(
    direct: float, indirect: float
) -> None:
    t, bits = transport(), codes("hadamard", 64)
    own = np.diag(t)
    truth = direct * own + indirect * (t.sum(axis=1) - own)
    found = weighted(FittedWeights(direct, indirect)(bits), bits, t)
    np.testing.assert_allclose(found, truth, rtol=1e-12)


@pytest.mark.parametrize("what", ["direct", "indirect", "masked"])
def test_error_of_random_codes_has_no_bias_and_the_variance_of_the_formulas(what: str) -> None:
    """E7: Q / (K - 1) for the slope, twice that for the fitted indirect light; the paper's masked
    sum has (S^2 + 2 Q) / K."""
    count, runs = 32, 3000
    rng = np.random.default_rng(11)
    t = transport()
    off = t - np.diag(np.diag(t))
    q, s = np.sum(off**2, axis=1), off.sum(axis=1)
    found = np.empty((runs, N))
    for run in range(runs):
        bits = random_bits(rng, count)
        photos = bits @ t.T
        if what == "masked":
            weights = MaskedWeights()(bits) * 4.0 / count
        else:
            weights = FittedWeights(float(what == "direct"), float(what == "indirect"))(bits)
        found[run] = np.sum(weights * photos, axis=0)
    expected = {
        "direct": q / (count - 1),
        "indirect": 2.0 * q / (count - 1),
        "masked": (s**2 + 2.0 * q) / count,
    }[what]
    truth = np.diag(t) if what == "direct" else s
    bias = np.abs(found.mean(axis=0) - truth)
    assert np.mean(bias < 3.0 * np.sqrt(expected / runs)) > 0.9
    ratio = found.var(axis=0, ddof=1) / expected
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    assert np.abs(ratio - 1.0).max() < 6.0 * np.sqrt(2.0 / runs)


def test_cells_that_never_change_have_no_weights() -> None:
    bits = random_bits(np.random.default_rng(5), 16)
    bits[:, 3], bits[:, 7] = True, False
    weights = FittedWeights(1.0, 1.0)(bits)
    assert not weights[:, [3, 7]].any()
    assert weights.any(axis=0).sum() == N - 2


def mixture(lit: Floats, dark: float = 3.0) -> CodeMixture:
    """Of quads whose lit shares were `lit` in each of the photos, (K, n)."""
    squares = np.sum(lit**2, axis=0)
    return CodeMixture(len(lit), np.sum(lit, axis=0), squares, np.full(lit.shape[1], dark))


@pytest.mark.parametrize(("lit", "weight"), [(0.0, 2.0), (0.5 * ALL_DARK, 2.0), (0.5, 0.0)])
def test_a_quad_of_several_cells_counts_where_all_that_it_sees_is_dark(
    lit: float, weight: float
) -> None:
    """As much in all as if that were half of the photos: of twelve, here in three of them."""
    none = np.zeros((12, 1))
    assert MaskedWeights().mixed(np.array([lit]), mixture(none)) == weight
    assert MaskedWeights().mixed(np.array([lit]), mixture(none, dark=0.0)) == 0.0


@pytest.mark.parametrize(("direct", "indirect"), [(1.0, 0.0), (0.0, 1.0), (1.0, 0.25)])
def test_a_quad_that_sees_one_cell_has_its_weights(direct: float, indirect: float) -> None:
    bits = random_bits(np.random.default_rng(0), 12)
    lit, how = bits.astype(float), FittedWeights(direct, indirect)
    found = np.stack([how.mixed(one, mixture(lit)) for one in lit])
    np.testing.assert_allclose(found, how(bits), atol=1e-12)


def test_quads_of_several_cells_are_fitted_by_a_line_over_the_share_that_was_lit() -> None:
    """Light in proportion to the share: direct is its slope, indirect twice its value at 0."""
    lit = np.random.default_rng(1).random((12, 5))
    photos = 0.3 + 0.8 * lit
    for how, wanted in (
        (FittedWeights(1.0, 0.0), 0.8),
        (FittedWeights(0.0, 1.0), 0.6),
        (FittedWeights(1.0, 0.5), 1.1),
    ):
        weights = np.stack([how.mixed(one, mixture(lit)) for one in lit])
        np.testing.assert_allclose(np.sum(weights * photos, axis=0), wanted)
    same = np.full((12, 1), 0.5)  # of what does not change nothing is known
    assert not FittedWeights(1.0, 1.0).mixed(np.array([0.7]), mixture(same)).any()


@pytest.mark.parametrize("block", [1, 2, 3])
def test_every_cell_takes_every_place_of_a_block_lit_and_dark(block: int) -> None:
    rows, cols = 7, 10
    patterns = make_checkers((rows, cols), block).reshape(-1, rows, cols)
    assert len(patterns) == 2 * block**2
    assert len(np.unique(patterns.reshape(len(patterns), -1), axis=0)) == len(patterns)
    np.testing.assert_array_equal(patterns.mean(axis=0), 0.5)
    # Blocks are square: a cell well inside meets (lit, lit right) in every alignment.
    run = [len(set(p[3, 3 : 3 + block])) == 1 for p in patterns]
    assert sum(run) == len(patterns) // block


@pytest.mark.parametrize("method", ["multi-image", "nayar"])
@pytest.mark.parametrize("goal", ["white", "split", "diagonal"])
def test_other_goals_are_refused(goal: str, method: str) -> None:
    with pytest.raises(RequestError, match="cannot do the goal"):
        make_recipe(Target(Goal(name=goal), GRID), CaptureScheme(method=method))  # type: ignore[arg-type]


def test_what_methods_cannot_use_is_refused() -> None:
    goal = Target(Goal(name="indirect"), GRID)
    lit = Target(Goal(name="indirect"), GRID, planes={"illumination": np.ones(N)})
    with pytest.raises(RequestError, match="takes no illumination"):
        make_recipe(lit, CaptureScheme(method="nayar"))
    with pytest.raises(RequestError, match="takes no pilot"):
        make_recipe(goal, CaptureScheme(method="multi-image", pilot=4, codes=132))
    with pytest.raises(RequestError, match="black exposures"):
        make_recipe(goal, CaptureScheme(method="multi-image", black_level="mask"))
    with pytest.raises(RequestError, match="at least 2"):
        make_recipe(goal, CaptureScheme(method="multi-image", codes=1))
