"""Photos of far light, less what their codes get wrong of smooth light."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.panels.lattice import Lattice
from pdcd.pictures.smooth import compute_smooth_correction
from pdcd.recipes.programs import LongRangeProgram

GRID = (12, 16)
N = GRID[0] * GRID[1]
Floats = NDArray[np.float64]


def far(radius: int) -> Floats:
    out = np.zeros((N, N))
    for n in range(N):
        for m in range(N):
            rows, cols = abs(n // 16 - m // 16), abs(n % 16 - m % 16)
            out[n, m] = float(max(rows, cols) > radius)
    return out


def photo(transport: Floats, radius: int, seed: int) -> tuple[Floats, Floats, Floats]:
    """The far photo as ideal panels take it with 128 codes, its truth, and its correction."""
    share = max(1, round(LongRangeProgram(radius).p * 128)) / 128
    bits = make_codes("balanced", GRID, 128, dual="same", p=share, seed=seed).primal
    primal, dual = LongRangeProgram(radius).pairs(bits, Lattice(GRID, "whole"))
    realised = dual.T.astype(float) @ primal.astype(float)
    weight = (realised * far(radius)).sum(axis=1) / far(radius).sum(axis=1)
    image = (realised * transport).sum(axis=1) / weight
    more = compute_smooth_correction(
        dual.astype(float), primal.astype(float), weight, image, GRID, beyond=radius
    )
    return image, (far(radius) * transport).sum(axis=1), more


@pytest.mark.parametrize("radius", [1, 2])
@pytest.mark.parametrize("reach", [2.0, 8.0])
def test_of_smooth_far_light_most_of_the_error_is_known(radius: int, reach: float) -> None:
    """T2.3 with few codes: light that falls off with distance, between surfaces of any albedo."""
    row, col = np.divmod(np.arange(N), 16)
    square = (row[:, None] - row) ** 2 + (col[:, None] - col) ** 2
    albedo = 0.5 + 0.5 * np.random.default_rng(1).random(N)
    transport = albedo[:, None] / (1.0 + square / reach**2) * albedo + np.eye(N)
    plain, corrected = [], []
    for seed in range(3):
        image, truth, more = photo(transport, radius, seed)
        plain.append(np.sqrt(np.mean((image - truth) ** 2)))
        corrected.append(np.sqrt(np.mean((image + more - truth) ** 2)))
    assert np.mean(corrected) < 0.7 * np.mean(plain)


def test_before_single_sharp_paths_little_is_done() -> None:
    rng = np.random.default_rng(2)
    transport = np.eye(N) + 0.3 * np.eye(N)[rng.permutation(N)]
    image, truth, more = photo(transport, 2, 0)
    assert np.sqrt(np.mean(more**2)) < 0.3 * np.sqrt(np.mean((image - truth) ** 2))
    assert not compute_smooth_correction(
        np.ones((1, N)), np.ones((1, N)), 1.0, np.zeros(N), GRID, beyond=2
    ).any()
