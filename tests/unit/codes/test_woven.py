"""Codes chosen together with their masks: what is measured, and what photos by them err."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import approx_fprime

from pdcd.codes import alike, woven
from pdcd.codes.far import are_joint_codes_best, make_long_range_codes, make_long_range_masks
from pdcd.panels.lattice import Lattice
from pdcd.probing.wanted import NearPart
from pdcd.recipes.programs import LongRangeProgram
from pdcd.virtual.scene.presets import PRESETS

Floats = NDArray[np.float64]

SMALL = (4, 5)
GRID = (12, 16)
N = GRID[0] * GRID[1]
BEST = 1.0 / 26.0


def nobody() -> None:
    """Stands for one who does not listen."""


def errs(mask: Floats, light: Floats, weight: float) -> float:
    """What is measured, by dense sums in double precision: camera cell by camera cell."""
    rows, cols = SMALL
    row, col = np.divmod(np.arange(rows * cols), cols)
    down, right = row[:, None] - row, col[:, None] - col
    apart = np.hypot(down, right)
    near = np.maximum(abs(down), abs(right)) <= 1
    same = sum(
        share * np.exp(-(apart**2) / (2.0 * reach**2))
        for reach, share in alike.CORRELATION_GAUSSIANS
    )
    same = same + woven.JOINT_OWN_LIGHT * np.eye(rows * cols)
    falls = (np.ones_like(apart), np.exp(-apart / 5.0), (2.0 / np.maximum(apart, 2.0)) ** 4)
    counted = mask.T @ light
    mean = counted[~near].mean()
    wrong = counted / mean - ~near
    total = 0.0
    for fall, share in zip(falls, (1.0, 1.0, alike.STEEP), strict=True):
        scale = share / np.mean(np.sum(fall**2, axis=1))
        for one, off in zip(fall, wrong, strict=True):
            total += scale * float((one * off) @ same @ (one * off))
    let_in = np.einsum("kn,km,nm->n", mask, light, near) / mean
    return (total + weight * float(let_in @ let_in)) / (rows * cols)


def test_the_measure_is_that_of_dense_sums_and_so_is_its_slope() -> None:
    both = np.random.default_rng(1).uniform(0.1, 0.9, (2, 3, 20)).astype(np.float32)
    value, slope = woven._Measure(SMALL, 1)(both, 0.3)

    def dense(place: Floats) -> float:
        mask, light = place.reshape(both.shape)
        return errs(mask, light, 0.3)

    place = both.astype(float).ravel()
    # Gaussians are rounded to parts of 256.
    assert value == pytest.approx(dense(place), rel=5e-3)
    expected = approx_fprime(place, dense, 1e-6)
    assert np.allclose(slope.ravel(), expected, rtol=0.02, atol=0.01 * np.abs(expected).max())
    light_alone = woven._Measure(SMALL, 1)(both, 0.0)[0]
    assert light_alone < value


def test_levels_are_parts_of_256_and_faint_light_is_left_out() -> None:
    light = woven.make_joint_codes(GRID, 32, 2, 3, nobody)
    assert light.shape == (32, N) and light.dtype == np.float64
    assert np.array_equal(light * 256.0, np.rint(light * 256.0))
    assert light.max() <= 1.0 and light[light > 0.0].min() >= 0.1 - 1.0 / 512.0
    assert np.unique(light).size > 50
    # Dark mostly, every cell lit somewhere, and none in most codes.
    assert 0.05 < (light > 0.0).mean() < 0.4
    assert ((light > 0.0).sum(axis=0) >= 1).all()


def test_they_are_chosen_once_and_by_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(woven, "_known", {})
    monkeypatch.setattr(woven, "WOVEN_KEPT", 2)
    signs: list[int] = []

    def chosen(seed: int) -> Floats:
        return woven.make_joint_codes((6, 8), 12, 1, seed, lambda: signs.append(seed))

    first = chosen(1)
    told = len(signs)
    assert told > 100
    assert np.array_equal(chosen(1), first) and len(signs) == told
    assert not np.array_equal(chosen(2), first)
    chosen(3)
    # The oldest is forgotten, and comes out the same again.
    before = len(signs)
    assert np.array_equal(chosen(1), first) and len(signs) > before
    assert len(woven._known) == 2


def test_who_watches_may_end_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(woven, "_known", {})

    def ends() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        woven.make_joint_codes((6, 8), 12, 1, 1, ends)
    assert not woven._known


@pytest.mark.parametrize(
    ("lattice", "count", "fits"),
    [
        ((24, 32), 128, True), ((24, 32), 256, True), ((24, 32), 512, False), ((32, 32), 128, True),
        ((48, 64), 16, False), ((12, 16), 16, True), ((12, 16), 128, True), ((12, 16), 500, False),
    ],
)  # fmt: skip
def test_where_codes_are_chosen_together(lattice: tuple[int, int], count: int, fits: bool) -> None:
    """Not of many cells, nor where there are codes for short stretches or for each cell alone."""
    assert are_joint_codes_best(lattice, count, BEST) is fits


def photographed(light: Floats | NDArray[np.bool_], transport: Floats) -> tuple[float, float]:
    """RMS error of far light over that of the true picture, each cell over its own weight, and that
    weight."""
    levels, mask = LongRangeProgram(2, grey=True).pairs(light, Lattice(GRID, "whole"))
    near = NearPart(GRID, 2).rows(0, N)
    counted = mask.astype(float).T @ levels.astype(float)
    assert not (counted * near).any()
    weight = (counted * (1.0 - near)).sum(axis=1) / (1.0 - near).sum(axis=1)
    truth = np.einsum("nm,cnm->nc", 1.0 - near, transport)
    off = np.einsum("nm,cnm->nc", counted, transport) / weight[:, None] - truth
    return float(np.sqrt(np.mean(off**2) / np.mean(truth**2))), float(weight.mean())


@pytest.mark.parametrize(
    ("name", "share"), [("open-book", 0.6), ("wax-disk", 0.7), ("disco-ball", 0.5)]
)
def test_photos_err_less_and_get_more_light_than_by_scattered_cells(
    name: str, share: float
) -> None:
    """And nothing of what is within the radius."""
    transport = PRESETS[name](GRID, {}).dense()
    scattered = make_long_range_codes(GRID, 64, BEST, np.random.default_rng(1), grey=True)
    before, faint = photographed(scattered, transport)
    now, bright = photographed(woven.make_joint_codes(GRID, 64, 2, 1, nobody), transport)
    assert now < share * before and bright > 2.0 * faint


def test_masks_of_levels_follow_finer_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Codes of levels are those that were chosen together with masks, whose error is mostly that of
    light close by: as coarse blocks as other codes have would leave more of it."""
    transport = PRESETS["wax-disk"](GRID, {}).dense()
    light = woven.make_joint_codes(GRID, 64, 2, 1, nobody)
    fine, _ = photographed(light, transport)
    seen = light @ NearPart(GRID, 2).rows(0, N) == 0.0
    mask = make_long_range_masks(light, seen, GRID, 2, grey=True)
    monkeypatch.setattr(alike, "FINE_SIDE", alike.CELL_BLOCK_SIDE)
    assert not np.array_equal(make_long_range_masks(light, seen, GRID, 2, grey=True), mask)
    coarse, _ = photographed(light, transport)
    assert fine < coarse


def test_bytes_are_those_that_are_taken() -> None:
    tracemalloc.start()
    try:
        woven._weave(GRID, 48, 2, 9, nobody)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 0.5 < most / woven.joint_codes_bytes(48, N) < 1.1
