"""Codes of light from afar: dealt out evenly, and counted alike, by a dense evaluation."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.codes import alike, far
from pdcd.codes.far import choose_times_lit, make_binary_masks, make_long_range_codes
from pdcd.codes.make import make_codes
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

MIDDLES = (([1, 4, 7, 10], 3), ([1, 3.5, 6, 9, 11.5, 14], [3, 2, 3, 3, 2, 3]))
"""Of the blocks along 12 rows and 16 columns, and how many of these they have."""


def cost(lit: Bools, open_: Bools) -> Floats:
    """What each camera cell errs of light that is alike over some cells, dense, (N,)."""
    same = correlate_light()
    counted = open_.astype(float).T @ lit.astype(float)
    weight = (counted * BEYOND).sum(axis=1) / BEYOND.sum(axis=1)
    error = counted / weight[:, None] - BEYOND
    row, col = (np.repeat(*middles) for middles in MIDDLES)
    row, col = row[ROW], col[COL]
    apart = np.hypot(ROW - row[:, None], COL - col[:, None])
    out = np.zeros(N)
    for fall in (np.ones((N, N)), np.exp(-apart / 5.0), (3.0 / np.maximum(apart, 3.0)) ** 4):
        light = np.round(fall * 64.0) / 64.0
        whole = 2.0 ** (1 + np.floor(np.log2((light**2).sum(axis=1))))
        lost = error * light
        out += np.einsum("yx,xz,yz->y", lost, same, lost) / whole
    return out


@pytest.mark.parametrize(("count", "times"), [(32, 1), (64, 1), (100, 2), (128, 2), (500, 2)])
def test_cells_are_lit_equally_often_and_codes_light_equally_many(count: int, times: int) -> None:
    lit = make_long_range_codes(GRID, count, BEST, np.random.default_rng(4))
    assert lit.shape == (count, N)
    assert np.array_equal(lit.sum(axis=0), np.full(N, times))
    assert times == choose_times_lit(count, N, BEST)
    if count % times == 0:
        assert np.ptp(lit.sum(axis=1)) <= 1
    again = make_long_range_codes(GRID, count, BEST, np.random.default_rng(5))
    assert not np.array_equal(lit, again)


def test_cells_are_lit_one_by_one_where_that_costs_little_light() -> None:
    """12 x 16 cells and 500 codes: two each, and far light without any error. Of 24 x 32 one in 768
    would be a twentieth of the light."""
    lit = make_long_range_codes(GRID, 500, BEST, np.random.default_rng(1))
    assert lit.sum(axis=1).max() == 1
    transport = np.random.default_rng(2).random((N, N))
    assert far_error(lit, make_binary_masks(lit, around(lit), GRID, RADIUS), transport) < 1e-14
    assert choose_times_lit(1000, 768, BEST) == round(0.5 * BEST * 1000)
    assert choose_times_lit(5, 768, BEST) == 1


@pytest.mark.parametrize("count", [64, 128])
def test_no_other_change_of_the_mask_would_err_less(count: int) -> None:
    """Held against the dense error: each cell's is lower than before, and no code more or less lets
    it fall further."""
    lit = make_long_range_codes(GRID, count, BEST, np.random.default_rng(7))
    seen = around(lit)
    open_ = make_binary_masks(lit, seen, GRID, RADIUS)
    assert not (open_ & ~seen).any()
    least, first = cost(lit, open_), cost(lit, seen)
    assert np.all(least <= first) and least.mean() < 0.9 * first.mean()
    for code in range(0, count, 7):
        other = open_.copy()
        other[code] ^= seen[code]
        assert np.all(cost(lit, other) >= least * (1.0 - 0.002))  # weights are rounded to 1/256


@pytest.mark.parametrize("seed", range(3))
def test_smooth_light_from_afar_errs_half_as_much(seed: int) -> None:
    """As by balanced codes that are closed around lit cells alone, as many, lit as is best."""
    rng = np.random.default_rng(seed)
    place = rng.random((2, 2)) * GRID
    down, right = (np.exp(-((ROW - r) ** 2 + (COL - c) ** 2) / 30.0) for r, c in place)
    transport = np.outer(0.2 + down, 0.2 + right) * (0.5 + 0.5 * rng.random(N))[:, None]
    lit = make_long_range_codes(GRID, 128, BEST, rng)
    bits = make_codes("balanced", GRID, 128, dual="same", p=5 / 128, seed=seed).primal
    now = far_error(lit, make_binary_masks(lit, around(lit), GRID, RADIUS), transport)
    assert now < 0.5 * far_error(bits, around(bits), transport)


def test_light_that_falls_off_errs_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """By distance, from places that differ: as under the surface of wax, and from a wall nearby."""
    rng = np.random.default_rng(11)
    lit = make_long_range_codes(GRID, 128, BEST, rng)
    seen = around(lit)
    apart = np.hypot(ROW[:, None] - ROW, COL[:, None] - COL)
    steep = (0.5 + rng.random(N)) * np.exp(-apart / 2.0)
    wall = np.maximum(0.0, COL[:, None] - COL) / np.maximum(apart, 1.0) ** 3
    falling = make_binary_masks(lit, seen, GRID, RADIUS)
    monkeypatch.setattr(alike, "MOST_FALLING", 0)
    flat = make_binary_masks(lit, seen, GRID, RADIUS)
    assert cost(lit, falling).mean() < cost(lit, flat).mean()
    for transport in (steep, wall):
        assert far_error(lit, falling, transport) < 0.9 * far_error(lit, flat, transport)


def test_the_order_of_cells_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums are exact, so that no machine chooses other codes: neither mirrored, nor in pieces."""
    lit = make_long_range_codes(GRID, 96, BEST, np.random.default_rng(3))
    open_ = make_binary_masks(lit, around(lit), GRID, RADIUS)
    turned = lit[:, ::-1]
    assert np.array_equal(make_binary_masks(turned, around(turned), GRID, RADIUS)[:, ::-1], open_)
    monkeypatch.setattr(far, "CHUNK_ENTRIES", 96 * 7)
    assert np.array_equal(make_binary_masks(lit, around(lit), GRID, RADIUS), open_)


def test_what_is_too_large_or_of_radius_0_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    lit = make_long_range_codes(GRID, 64, BEST, np.random.default_rng(3))
    assert np.array_equal(make_binary_masks(lit, ~lit, GRID, 0), ~lit)
    seen = around(lit)
    assert not np.array_equal(make_binary_masks(lit, seen, GRID, RADIUS), seen)
    monkeypatch.setattr(far, "MOST_EVENED", lit.size - 1)
    assert np.array_equal(make_binary_masks(lit, seen, GRID, RADIUS), seen)


def test_cells_that_are_never_open_stay_closed() -> None:
    """Few codes light so many cells that some see none of them."""
    lit = make_long_range_codes(GRID, 8, BEST, np.random.default_rng(1))
    seen = around(lit)
    assert not seen.any(axis=0).all()
    assert not (make_binary_masks(lit, seen, GRID, RADIUS) & ~seen).any()
    dark = np.zeros_like(lit)
    assert make_binary_masks(dark, ~dark, GRID, RADIUS).all()
