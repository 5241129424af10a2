"""A pilot finds sharp paths, the codes after it avoid them, and it says when it does not pay."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse
from numpy.typing import NDArray

from pdcd.codes.hadamard import make_prior_codes
from pdcd.codes.make import make_codes
from pdcd.codes.pilot.codes import SCOUTS, choose_pilot_count, make_pilot_codes
from pdcd.codes.pilot.links import (
    SHARP,
    compute_path_correction,
    estimate_links,
    estimate_sharpness,
    predict_pilot_errors,
)
from tests.places import DATA
from tests.sampled import sampled

pytestmark = pytest.mark.whole

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

GRID = (24, 32)
CELLS = 24 * 32


def matrix_scene(name: str) -> Floats:
    with np.load(DATA / f"{name}.npz") as file:
        return np.asarray(file["transport"], dtype=np.float64)


def smooth(strength: float) -> Floats:
    """Diffuse light that falls off with distance, (N, N), rows sum to about `strength`."""
    row, col = np.divmod(np.arange(CELLS), GRID[1])
    squared = (row[:, None] - row) ** 2 + (col[:, None] - col) ** 2
    spread = 1.0 / (4.0 + squared)
    scaled: Floats = strength * spread / spread.sum(axis=1).mean()
    return scaled


def scattered_paths(seed: int) -> Floats:
    """Direct light, weak smooth light, and one sharp path a cell to anywhere, one way only."""
    rng = np.random.default_rng(seed)
    transport = np.diag(rng.uniform(0.5, 1.5, CELLS)) + smooth(0.1)
    transport[np.arange(CELLS), rng.permutation(CELLS)] += rng.uniform(0.1, 0.3, CELLS)
    return transport


def two_caustics(seed: int) -> Floats:
    """Two patches, each thrown onto another place, shrunk or turned, there and back."""
    rng = np.random.default_rng(seed)
    transport = np.diag(rng.uniform(0.5, 1.5, CELLS)) + smooth(0.2)
    paths = np.zeros((CELLS, CELLS))
    for r, c in np.ndindex(8, 8):
        paths[(14 + r // 2) * 32 + 20 + c // 2, (1 + r) * 32 + 2 + c] = 0.1
        paths[(13 + c) * 32 + 2 + r, (1 + r) * 32 + 22 + c] = 0.25
    return transport + paths + paths.T


def take_pilot(
    transport: Floats, count: int, seed: int, sigma: float = 0.0
) -> tuple[Bools, Floats]:
    codes = make_pilot_codes(GRID, count, seed)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, codes.shape)
    return codes, codes @ transport.T + sigma * noise


def shot_error(transport: Floats, codes: Bools, paths: Any = None) -> float:
    """RMS error of one indirect photo over the RMS of the truth; corrected if paths are given."""
    lit = codes.astype(np.float64)
    probing = (1.0 - lit).T @ lit
    weight = float(probing.sum() / (CELLS * (CELLS - 1)))
    image = (probing / weight * transport).sum(axis=1)
    if paths is not None:
        image = image + compute_path_correction(1.0 - lit, lit, weight, paths)
    truth = transport.sum(axis=1) - np.diag(transport)
    return float(np.sqrt(np.mean((image - truth) ** 2) / np.mean(truth**2)))


def plain_error(transport: Floats, family: str, count: int, seed: int) -> float:
    codes = make_codes(family, GRID, count, dual="complement", seed=seed)
    return shot_error(transport, codes.primal)


def piloted_error(transport: Floats, count: int, seed: int, sigma: float = 0.0) -> float:
    codes, photos = take_pilot(transport, {48: 32, 128: 64}[count], seed, sigma)
    paths = estimate_links(codes, photos, GRID, sigma=sigma)
    rng = np.random.default_rng(seed)
    return shot_error(transport, make_prior_codes(GRID, count - len(codes), paths, rng), paths)


@pytest.mark.parametrize(
    ("count", "parts", "share"),
    [
        *((8, 1, 0), (11, 1, 0), (12, 1, 8), (16, 1, 8), (18, 1, 0), (20, 1, 12), (23, 1, 0)),
        *((24, 1, 16), (32, 1, 16), (48, 1, 16), (130, 1, 0), (512, 1, 16), (512, 4, 16)),
        *((25, 2, 0), (24, 2, 16), (40, 4, 8)),
    ],
)
def test_a_pilot_takes_at_most_two_thirds_and_leaves_an_order(
    count: int, parts: int, share: int
) -> None:
    assert choose_pilot_count(count, parts) == share


def test_single_paths_are_found_with_their_strength() -> None:
    transport = scattered_paths(0)
    codes, photos = take_pilot(transport, 64, 0)
    found = estimate_links(codes, photos, GRID).toarray()
    true = np.where(transport - smooth(0.1) > 0.09, transport, 0.0)
    np.fill_diagonal(true, 0.0)
    assert np.mean(found[true > 0.0] > 0.0) > 0.99
    assert np.sum((found - true) ** 2) < 0.02 * np.sum(true**2)


def test_noise_alone_is_hardly_taken_for_paths() -> None:
    codes, photos = take_pilot(np.zeros((CELLS, CELLS)), 64, 1, sigma=1.0)
    assert estimate_links(codes, photos, GRID, sigma=1.0).nnz < 0.2 * CELLS


def test_a_black_scene_has_no_paths() -> None:
    codes, photos = take_pilot(np.zeros((CELLS, CELLS)), 32, 1)
    assert estimate_links(codes, photos, GRID).nnz == 0
    assert estimate_sharpness(codes[:SCOUTS], photos[:SCOUTS]) == 0.0


@pytest.mark.parametrize(
    ("build", "count"),
    sampled(
        [(scattered_paths, 48), (scattered_paths, 128), (two_caustics, 128), (two_caustics, 48)], 2
    ),
)
def test_the_same_number_of_codes_errs_far_less_with_a_pilot(build: Any, count: int) -> None:
    transport = build(3)
    assert piloted_error(transport, count, 3) < plain_error(transport, "bernoulli", count, 3) / 20
    assert piloted_error(transport, count, 3) < plain_error(transport, "balanced", count, 3) / 3


@pytest.mark.long
def test_a_path_traced_mirror_errs_ten_times_less_than_coins() -> None:
    transport = matrix_scene("mirror_32x24")
    for count, gain in ((48, 8.0), (128, 40.0)):
        coins = np.mean([plain_error(transport, "bernoulli", count, s) for s in range(3)])
        assert np.mean([piloted_error(transport, count, s) for s in range(3)]) < coins / gain


def test_sensor_noise_leaves_most_of_the_gain() -> None:
    """Noise of 1 % of the white level in each pilot photo."""
    transport = two_caustics(5)
    sigma = 0.01 * float(transport.sum(axis=1).mean())
    assert piloted_error(transport, 128, 5, sigma) < plain_error(transport, "balanced", 128, 5) / 3


def test_the_correction_is_exact_when_the_paths_are() -> None:
    transport = scattered_paths(7)
    codes = make_codes("bernoulli", GRID, 6, dual="complement", seed=1).primal
    rest = transport - np.diag(np.diag(transport))
    assert shot_error(transport, codes) > 0.1
    assert shot_error(transport, codes, scipy.sparse.csr_array(rest)) < 1e-12


@pytest.mark.long
def test_a_pilot_pays_on_sharp_paths_and_not_on_smooth_light() -> None:
    smooth_scene = np.diag(np.linspace(0.5, 1.5, CELLS)) + smooth(0.3)
    scenes = (
        (scattered_paths(0), True),
        (two_caustics(0), True),
        (matrix_scene("mirror_32x24"), True),
        (smooth_scene, False),
        (matrix_scene("corner_32x24"), False),
    )
    for transport, pays in scenes:
        for sigma in (0.0, 0.002):
            codes, photos = take_pilot(transport, 64, 1, sigma)
            paths = estimate_links(codes, photos, GRID, sigma=sigma)
            assert predict_pilot_errors(codes, photos, paths, 128, sigma=sigma).pays is pays


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("sigma", [0.0, 0.02])
def test_scouts_measure_how_sharp_light_is(seed: int, sigma: float) -> None:
    """Against the matrix itself, for unrelated paths: sqrt(mean Q / mean S^2), noise left out."""
    rng = np.random.default_rng(seed)
    transport = np.diag(rng.uniform(0.5, 1.5, CELLS))
    for _ in range(5):
        transport[np.arange(CELLS), rng.permutation(CELLS)] += 0.1
    codes, photos = take_pilot(transport, 32, seed, sigma)
    rest = transport - np.diag(np.diag(transport))
    true = np.sqrt(np.mean(np.sum(rest**2, axis=1)) / np.mean(np.sum(rest, axis=1) ** 2))
    seen = estimate_sharpness(codes[:SCOUTS], photos[:SCOUTS], sigma=sigma)
    assert seen == pytest.approx(true, rel=0.1)


def test_noise_that_is_told_of_is_neither_sharp_light_nor_an_error_of_codes() -> None:
    """Smooth light in photos whose noise is a third of it."""
    transport = np.eye(CELLS) + smooth(0.3)
    sigma = 0.1
    codes, photos = take_pilot(transport, 32, 0, sigma)
    assert estimate_sharpness(codes[:SCOUTS], photos[:SCOUTS]) > 2 * SHARP
    assert estimate_sharpness(codes[:SCOUTS], photos[:SCOUTS], sigma=sigma) < SHARP
    assert estimate_sharpness(codes[:SCOUTS], photos[:SCOUTS], sigma=9.0) == 0.0
    nothing = scipy.sparse.csr_array((CELLS, CELLS))
    blind, told = (
        predict_pilot_errors(codes, photos, nothing, 128, sigma=s).unguided for s in (0.0, sigma)
    )
    assert told < 0.5 * blind


@pytest.mark.parametrize("level", [0.0, 5.0])
def test_ambient_light_that_is_taken_off_hides_no_sharp_light(level: float) -> None:
    """Left in, it looks like smooth indirect light."""
    transport, sigma = scattered_paths(0), 0.02
    codes, photos = take_pilot(transport, SCOUTS, 3, sigma)
    known = estimate_sharpness(codes, photos, sigma=sigma)
    rng = np.random.default_rng(1)
    around = level * rng.uniform(0.5, 1.5, CELLS)
    hidden = photos + around
    measured = around + 0.05 * rng.standard_normal(CELLS)
    off = estimate_sharpness(
        codes, hidden - measured, sigma=sigma, taken_off=np.full(CELLS, 0.05**2)
    )
    assert known > 2.0 * SHARP
    assert off == pytest.approx(known, rel=0.1)
    assert level == 0.0 or estimate_sharpness(codes, hidden, sigma=sigma) < SHARP


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_ambient_light_is_no_sharp_light(seed: int) -> None:
    """Ten times as strong as the indirect light: what its noise is off by by chance is no path."""
    smooth_light = smooth(0.2) + np.diag(np.ones(CELLS))
    codes, photos = take_pilot(smooth_light, SCOUTS, seed, 2.0)
    off = np.full(CELLS, 1.0)
    assert estimate_sharpness(codes, photos, sigma=2.0, taken_off=off) < SHARP
    nothing = np.zeros_like(photos)
    assert estimate_sharpness(codes, nothing, sigma=1.0, taken_off=off) == 0.0


def test_scouts_tell_sharp_paths_from_smooth_light() -> None:
    smooth_scene = np.diag(np.linspace(0.5, 1.5, CELLS)) + smooth(0.3)
    for transport, sharp in (
        (scattered_paths(1), True),
        (two_caustics(1), True),
        (matrix_scene("mirror_32x24"), True),
        (smooth_scene, False),
        (matrix_scene("corner_32x24"), False),
        (np.eye(CELLS), False),
    ):
        codes, photos = take_pilot(transport, SCOUTS, 1)
        assert (estimate_sharpness(codes, photos) >= SHARP) is sharp


def test_the_error_of_codes_that_are_not_guided_is_predicted() -> None:
    """One path a cell to anywhere is what the rule was made for."""
    transport = scattered_paths(2)
    codes, photos = take_pilot(transport, 64, 2)
    found = estimate_links(codes, photos, GRID)
    predicted = predict_pilot_errors(codes, photos, found, 64 + 128).unguided
    measured = np.mean([plain_error(transport, "hadamard", 128, seed) for seed in range(5)])
    assert predicted == pytest.approx(measured, rel=0.25)


@pytest.mark.parametrize("count", [8, 32])
def test_seeds_and_parts_of_a_pilot_have_codes_of_their_own(count: int) -> None:
    first, second = (make_pilot_codes(GRID, count, seed) for seed in (1, 2))
    assert (first != second).any(axis=1).all()
    assert count == 8 or not np.array_equal(first[SCOUTS:12], first[12:20])
