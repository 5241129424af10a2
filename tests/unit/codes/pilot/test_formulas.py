"""What a pilot computes, held against sums over all codes and cells, row by row."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse
from numpy.typing import NDArray

from pdcd.codes.pilot import links, matching
from pdcd.codes.pilot.codes import make_pilot_codes
from pdcd.codes.pilot.links import (
    compute_path_correction,
    estimate_links,
)
from pdcd.codes.pilot.scene_light import (
    compute_projections,
    to_signs,
)

Floats = NDArray[np.float64]
GRID = (6, 8)
N = GRID[0] * GRID[1]


def scene(seed: int) -> Floats:
    """Transport with direct light and one sharp path into each of some cells."""
    rng = np.random.default_rng(seed)
    transport = np.diag(rng.uniform(0.5, 1.0, N))
    for cell in range(0, N, 3):
        transport[cell, (cell + N // 2 + 3) % N] += 0.4
    return transport


def shown(codes: NDArray[np.bool_], transport: Floats) -> Floats:
    return np.asarray(codes.astype(np.float64) @ transport.T)


def test_signs_and_projections_are_those_of_the_codes() -> None:
    codes = make_pilot_codes(GRID, 32, seed=1)
    transport = scene(0)
    photos = shown(codes, transport)
    assert set(np.unique(to_signs(codes))) == {-1.0, 1.0} and to_signs(codes)[codes].min() == 1.0
    # In each half of the time, so that twice the deviation is T h.
    assert np.allclose(compute_projections(photos), to_signs(codes) @ transport.T)


@pytest.mark.parametrize("chunk", [2**17, 7])
def test_what_is_added_for_paths_is_what_their_weights_lack(
    chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "PATH_CHUNK", chunk)
    rng = np.random.default_rng(4)
    left, right = rng.random((70, N)), rng.random((70, N))
    paths = scipy.sparse.random_array((N, N), density=0.05, rng=rng).tocsr()
    realised = left.T @ right / 0.7
    wanted = ((1.0 - realised) * paths.toarray()).sum(axis=1)
    assert np.allclose(compute_path_correction(left, right, 0.7, paths), wanted)
    # Each cell over its own weight, and each path wanted by its own share.
    share, weight = rng.random((N, N)), 0.5 + rng.random(N)
    lacking = (share - left.T @ right / weight[:, None]) * paths.toarray()
    row, column = paths.tocoo().coords
    found = compute_path_correction(left, right, weight, paths, share[row, column])
    assert np.allclose(found, lacking.sum(axis=1))


def test_noise_of_a_pilot_is_that_of_its_projections(monkeypatch: pytest.MonkeyPatch) -> None:
    codes = make_pilot_codes(GRID, 32, seed=7)
    photos, sigma = shown(codes, scene(3)), np.random.default_rng(8).random((32, N))
    heard: list[Any] = []
    monkeypatch.setattr(links, "pursue_paths", lambda *told: heard.append(told))
    estimate_links(codes, photos, GRID, sigma=sigma)
    h, z, grid, level = heard[0]
    assert (
        np.array_equal(h, to_signs(codes))
        and np.allclose(z, compute_projections(photos))
        and grid == GRID
    )
    assert np.allclose(level**2, 4.0 * (sigma**2).mean(axis=0))


def test_smooth_light_is_the_likeliest_beside_direct_light() -> None:
    """By the normal equations of each cell: photos = b / 2 + d code, with a prior on b alone."""
    rng = np.random.default_rng(13)
    codes = (rng.random((8, 5)) < 0.5).astype(np.float64)
    codes[0], codes[1] = 1.0, 0.0
    left, variance = rng.random((8, 5)), rng.uniform(0.01, 0.1, 5)
    usual, spread = rng.random(5), rng.uniform(0.1, 1.0, 5)
    priors = matching._Round(usual, spread, usual, spread)
    found = matching._smooth_light(codes, left, variance, priors)
    for n in range(5):
        basis = np.stack([np.full(8, 0.5), codes[:, n]], axis=1)
        gram = basis.T @ basis / variance[n] + np.diag([1.0 / spread[n], 0.0])
        right = basis.T @ left[:, n] / variance[n] + np.array([usual[n] / spread[n], 0.0])
        assert found[n] == pytest.approx(np.linalg.solve(gram, right)[0])


def test_evidence_is_what_photos_say_when_direct_light_may_be_anything() -> None:
    rng = np.random.default_rng(14)
    codes = make_pilot_codes((3, 4), 8, seed=1)
    photos, noise = rng.random((8, 12)) + codes, rng.uniform(0.0, 0.1, 12)
    found = matching._Likelihood(codes, photos, noise)
    metric, product, square = found.metric(found.widest())
    for n in range(12):
        code = codes[:, n].astype(np.float64)
        variance = matching.OTHER**2 + (noise[n] / found.unit) ** 2
        # Direct light as light of a variance beyond all bounds.
        covariance = variance * np.eye(8) + 0.25 + 1e7 * np.outer(code, code)
        inverse = np.linalg.inv(covariance)
        over = photos[:, n] / found.unit - found.widest().smooth[n] / 2.0
        assert np.allclose(metric[n], inverse, atol=1e-4)
        assert np.allclose(product[n], inverse @ over, atol=1e-3)
        assert square[n] == pytest.approx(over @ inverse @ over, abs=1e-3)
