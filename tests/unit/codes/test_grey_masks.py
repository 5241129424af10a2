"""Grey masks for light from afar: the levels that err least, by a solver of another kind."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from pdcd.codes import alike, far, greyed
from pdcd.codes.far import choose_times_lit, make_long_range_codes, make_long_range_masks
from pdcd.panels.lattice import Lattice
from pdcd.recipes.programs import LongRangeProgram
from tests.unit.codes._oracles import (
    BEST,
    BEYOND,
    COL,
    GRID,
    RADIUS,
    ROW,
    Bools,
    Floats,
    N,
    around,
    correlate_light,
    far_error,
)  # fmt: skip


def coded(count: int, seed: int) -> tuple[Bools, Bools, Floats]:
    """Codes for grey masks, where these may be open, and how far they are."""
    lit = make_long_range_codes(GRID, count, BEST, np.random.default_rng(seed), grey=True)
    seen = around(lit)
    mask = make_long_range_masks(lit, seen, GRID, RADIUS, grey=True)
    return lit, seen, np.asarray(mask, np.float64)


def test_nothing_from_within_the_radius_gets_in() -> None:
    lit, seen, mask = coded(96, 1)
    assert not mask[~seen].any() and mask.max() <= 1.0 and mask.min() >= 0.0
    assert not ((mask.T @ lit) * (1.0 - BEYOND)).any()
    assert np.array_equal(mask * 256.0, np.rint(mask * 256.0))
    assert np.unique(mask).size > 100


def test_no_other_levels_err_less() -> None:
    """Held against bounded least squares by a trust region (scipy), on the dense covariance."""
    lit, seen, mask = coded(64, 2)
    root = np.linalg.cholesky(correlate_light())
    level = greyed.MEAN_OPEN_LEVEL * seen.mean()
    counted = level * lit.sum() / N
    for cell in (0, 37, 100, 150):
        # The middle of a cell's block is within a cell of it, so its own distance does nearly.
        apart = np.hypot(ROW - ROW[cell], COL - COL[cell])
        falls = (np.ones(N), np.exp(-apart / 5.0), (3.0 / np.maximum(apart, 3.0)) ** 4)
        may = seen[:, cell]
        parts = [2.0 ** (-0.5 * np.frexp(np.sum(f**2))[1]) * f[:, None] * root for f in falls]
        tall = np.concatenate([(lit[may] @ part).T for part in parts])
        aim = np.concatenate([(counted * BEYOND[cell]) @ part for part in parts])
        best = lsq_linear(tall, aim, bounds=(0.0, 1.0))
        found = 0.5 * np.sum((tall @ mask[may, cell] - aim) ** 2)
        start = 0.5 * np.sum((tall @ np.full(may.sum(), greyed.MEAN_OPEN_LEVEL) - aim) ** 2)
        assert best.success and found < best.cost + 0.05 * (start - best.cost)


def test_steps_are_safe_and_hardly_shorter_than_need_be() -> None:
    lit, _, _ = coded(64, 3)
    found = np.stack(
        [
            block.together
            for block in alike.split_into_cell_blocks(lit.astype(np.float64), GRID, RADIUS)
        ]
    )
    steepest = np.linalg.eigvalsh(found)[:, -1]
    taken = greyed._steepest(found)
    assert np.all(taken >= steepest * (1.0 - 1e-12)) and np.all(taken < 1.1 * steepest)
    assert np.mean(found.sum(axis=2).max(axis=1) / steepest) > 1.3


@pytest.mark.parametrize("seed", range(2))
def test_smooth_light_errs_less_than_by_black_and_white(seed: int) -> None:
    rng = np.random.default_rng(seed)
    place = rng.random((2, 2)) * GRID
    down, right = (np.exp(-((ROW - r) ** 2 + (COL - c) ** 2) / 30.0) for r, c in place)
    apart = np.hypot(ROW[:, None] - ROW, COL[:, None] - COL)
    wide = np.outer(0.2 + down, 0.2 + right) * (0.5 + 0.5 * rng.random(N))[:, None]
    steep = (0.5 + rng.random(N)) * np.exp(-apart / 2.0)
    paths = rng.permutation(np.eye(N))
    lit, _, mask = coded(128, seed)
    plain = make_long_range_codes(GRID, 128, BEST, np.random.default_rng(seed))
    even = make_long_range_masks(plain, around(plain), GRID, RADIUS)
    for transport, share in ((wide, 0.6), (steep, 0.8), (paths, 1.0)):
        assert far_error(lit, mask, transport) < share * far_error(plain, even, transport)


def test_the_order_of_cells_changes_nothing() -> None:
    """Sums are exact, so that no machine chooses other levels."""
    lit, seen, mask = coded(96, 3)
    turned = make_long_range_masks(lit[:, ::-1], seen[:, ::-1], GRID, RADIUS, grey=True)
    assert np.array_equal(turned[:, ::-1], mask)
    shuffled = np.random.default_rng(4).permutation(96)
    again = make_long_range_masks(lit[shuffled], seen[shuffled], GRID, RADIUS, grey=True)
    assert np.array_equal(again, mask[shuffled])


def test_light_that_is_not_taken_to_fall_off(monkeypatch: pytest.MonkeyPatch) -> None:
    lit, seen, mask = coded(96, 5)
    monkeypatch.setattr(alike, "MOST_FALLING", 0)
    flat = np.asarray(make_long_range_masks(lit, seen, GRID, RADIUS, grey=True), np.float64)
    assert not flat[~seen].any() and not np.array_equal(flat, mask)
    wide = np.exp(-((ROW - 3.0) ** 2 + (COL - 5.0) ** 2) / 50.0) * np.ones((N, 1))
    assert far_error(lit, flat, wide) < far_error(lit, mask, wide)


@pytest.mark.parametrize(("count", "cells", "times"), [
    (32, 768, 1), (64, 768, 1), (128, 768, 2), (256, 768, 2), (512, 768, 3), (512, 4096, 10),
    (1000, 768, 19),
])  # fmt: skip
def test_cells_are_lit_more_seldom(count: int, cells: int, times: int) -> None:
    """But for so many codes and cells that levels would take long to choose."""
    assert choose_times_lit(count, cells, BEST, grey=True) == times
    usual = choose_times_lit(count, cells, BEST)
    assert times <= usual and (greyed.can_make_grey_masks(count, cells) or times == usual)


def test_black_and_white_where_grey_levels_gain_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    # Each cell alone, as there are so many codes.
    lit, seen, mask = coded(500, 1)
    assert lit.sum(axis=1).max() == 1 and np.array_equal(mask, seen)
    lit, seen, mask = coded(64, 1)
    assert np.array_equal(
        make_long_range_masks(lit, seen, GRID, RADIUS),
        far.make_binary_masks(lit, seen, GRID, RADIUS),
    )
    assert np.array_equal(make_long_range_masks(lit, ~lit, GRID, 0, grey=True), ~lit)
    monkeypatch.setattr(greyed, "MOST_WORK", 64 * 64 * N - 1)
    assert make_long_range_masks(lit, seen, GRID, RADIUS, grey=True).dtype == np.bool_
    plain = make_long_range_codes(GRID, 64, BEST, np.random.default_rng(1))
    assert np.array_equal(
        make_long_range_codes(GRID, 64, BEST, np.random.default_rng(1), grey=True), plain
    )


def test_windows_of_quarter_cells_are_levelled_over_their_own_lattice() -> None:
    lattice = Lattice(GRID, "quarter")
    lit = make_long_range_codes(lattice.shape, 96, BEST, np.random.default_rng(6), grey=True)
    primal, dual = LongRangeProgram(RADIUS, grey=True).pairs(lit, lattice)
    assert primal is lit and dual.shape == (96, 13 * 17) and dual.dtype == np.float64
    plain, black = LongRangeProgram(RADIUS).pairs(lit, lattice)
    assert plain is lit and black.dtype == np.bool_
