"""Sharp light of each cell, by four photos of single codes, against transport that is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.pilot.codes import SCOUTS, pilot_codes
from pdcd.codes.pilot.scene_light import sharp_squares
from pdcd.errors import ConfigError

GRID = (24, 32)
CELLS = GRID[0] * GRID[1]
Floats = NDArray[np.float64]


def scouts(seed: int) -> NDArray[np.bool_]:
    return pilot_codes(GRID, SCOUTS, seed)


def photos_of(transport: Floats, codes: NDArray[np.bool_]) -> Floats:
    """T i_k, (K, N, 1), by the whole matrix."""
    found: Floats = (codes.astype(np.float64) @ transport.T)[..., None]
    return found


def sharp(seed: int) -> Floats:
    """In the left half each cell gets 0.2 from each of four others anywhere."""
    rng = np.random.default_rng(seed)
    paths = np.zeros((CELLS, CELLS))
    for cell in range(CELLS):
        if cell % GRID[1] < GRID[1] // 2:
            paths[cell, rng.choice(np.delete(np.arange(CELLS), cell), 4, replace=False)] = 0.2
    return paths


def smooth() -> Floats:
    """Direct light, and a haze from everywhere."""
    return np.asarray(np.eye(CELLS) + 0.5 / CELLS)


def test_squares_of_sharp_paths_are_found_where_they_arrive() -> None:
    """Their sum is 4 x 0.2^2 on the left and nothing on the right."""
    col = np.arange(CELLS) % GRID[1]
    nothing = np.zeros((SCOUTS, CELLS, 1))
    squares = []
    for seed in range(8):
        photos = photos_of(smooth() + sharp(seed), scouts(seed))
        found = sharp_squares(scouts(seed), photos, GRID, sigma=nothing, paths=nothing)
        squares.append(found[:, 0])
    found = np.mean(squares, axis=0)
    left, right = found[col < GRID[1] // 2 - 1], found[col > GRID[1] // 2]
    assert left.mean() == pytest.approx(4 * 0.2**2, rel=0.1)
    assert right.max() < 1e-3 * left.mean()


def test_known_paths_and_noise_do_not_count() -> None:
    codes = scouts(1)
    photos, known = photos_of(smooth() + sharp(1), codes), photos_of(sharp(1), codes)
    nothing = np.zeros_like(known)
    left = sharp_squares(codes, photos, GRID, sigma=nothing, paths=known)
    assert left.max() < 1e-4
    noisy = photos + 0.05 * np.random.default_rng(0).standard_normal(photos.shape)
    bare = sharp_squares(codes, noisy, GRID, sigma=nothing, paths=known)
    less = sharp_squares(codes, noisy, GRID, sigma=nothing + 0.05, paths=known)
    assert bare.mean() == pytest.approx(0.75 * 4 * 0.05**2, rel=0.1)
    assert less.mean() < 0.25 * bare.mean()


def test_photos_that_do_not_fit_are_refused() -> None:
    nothing = np.zeros((SCOUTS, CELLS - 1, 1))
    with pytest.raises(ConfigError):
        sharp_squares(scouts(0), nothing, GRID, sigma=nothing, paths=nothing)
