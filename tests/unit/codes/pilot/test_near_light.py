"""Light from right beside cells, found in photos of single codes of a transport that is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.pilot.codes import make_pilot_codes
from pdcd.codes.pilot.scene_light import estimate_adjacent_light

Floats = NDArray[np.float64]
GRID = (24, 32)
N = GRID[0] * GRID[1]


def falling(power: float) -> Floats:
    """Transport (N, N) that falls with distance, 0.02 from each cell beside one; none to itself."""
    row, col = np.divmod(np.arange(N), GRID[1])
    far = (row[:, None] - row) ** 2 + (col[:, None] - col) ** 2
    paths = 0.02 * np.maximum(far / 1.5, 1e-9) ** -power
    np.fill_diagonal(paths, 0.0)
    return np.asarray(paths)


def beside(paths: Floats) -> Floats:
    """Mean over the eight cells around, (N,)."""
    row, col = np.divmod(np.arange(N), GRID[1])
    near = (np.abs(row[:, None] - row) <= 1) & (np.abs(col[:, None] - col) <= 1)
    return np.asarray(np.sum(paths * near, axis=1) - np.diag(paths)) / 8.0


@pytest.mark.parametrize("count", [4, 16])
@pytest.mark.parametrize("power", [1.0, 2.0])
def test_light_from_beside_is_found_whatever_direct_light_there_is(
    count: int, power: float
) -> None:
    paths = falling(power)
    rng = np.random.default_rng(1)
    found = []
    for seed in range(4):
        codes = make_pilot_codes(GRID, count, seed).astype(np.bool_)
        photos = codes @ paths.T + codes * rng.uniform(0.5, 2.0, N) + 0.3
        found.append(estimate_adjacent_light(codes, np.stack([photos, 2.0 * photos], axis=2), GRID))
    mean = np.sqrt(np.mean(np.square(found), axis=(0, 1)))
    true = float(np.sqrt(np.mean(beside(paths) ** 2)))
    assert 0.55 * true < mean[0] < 1.8 * true
    assert mean[1] == pytest.approx(2.0 * mean[0])


def test_paths_from_afar_add_little() -> None:
    """Each cell gets all of its light from one other, anywhere: of it less than a hundredth is
    taken to come from beside."""
    rng = np.random.default_rng(2)
    found = []
    for seed in range(4):
        codes = make_pilot_codes(GRID, 16, seed).astype(np.bool_)
        photos = (codes[:, rng.permutation(N)] + 0.5).astype(np.float64)[..., None]
        found.append(estimate_adjacent_light(codes, photos, GRID))
    assert float(np.sqrt(np.mean(np.square(found)))) < 0.02


def test_codes_that_tell_nothing_find_nothing() -> None:
    codes = np.ones((4, 12), np.bool_)
    photos = np.random.default_rng(3).random((4, 12, 3))
    assert not estimate_adjacent_light(codes, photos, (3, 4)).any()
