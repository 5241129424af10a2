"""What a pilot computes, held against sums over all codes and cells, row by row."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse
from numpy.typing import NDArray

from pdcd.codes.pilot import links, matching, pursuit
from pdcd.codes.pilot.codes import make_pilot_codes
from pdcd.codes.pilot.links import (
    PilotPrediction,
    compute_path_correction,
    estimate_links,
    estimate_sharpness,
    predict_pilot_errors,
)
from pdcd.codes.pilot.scene_light import (
    compute_projections,
    estimate_direct_light,
    to_signs,
)
from pdcd.errors import ConfigError

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
    own = np.array(
        [np.mean(to_signs(codes)[:, n] * compute_projections(photos)[:, n]) for n in range(N)]
    )
    assert np.allclose(estimate_direct_light(codes, photos), own)


@pytest.mark.parametrize("sigma", [0.0, 0.02])
def test_sharpness_is_what_is_left_beside_direct_light(sigma: float) -> None:
    codes = make_pilot_codes(GRID, 4, seed=2)
    photos = shown(codes, scene(1)) + np.random.default_rng(0).normal(0.0, 0.02, (4, N))
    h, z = np.where(codes, 1.0, -1.0), 2.0 * (photos - photos.mean(axis=0))
    direct, squares = (h * z).mean(axis=0), np.zeros(N)
    for n in range(N):
        squares[n] = np.sum((z[:, n] - h[:, n] * direct[n]) ** 2) / 2.0
    square = squares.mean() - 4.0 * sigma**2
    indirect = 2.0 * photos.mean(axis=0) - direct
    wanted = np.sqrt(0.75 * square / np.mean(indirect**2))
    assert estimate_sharpness(codes, photos, sigma=sigma) == pytest.approx(wanted)
    loud = estimate_sharpness(codes, photos, sigma=9.0)
    assert loud == 0.0 == estimate_sharpness(codes, np.zeros((4, N)))


@pytest.mark.parametrize("chunk", [2**17, 7, 1])
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


def test_worth_is_by_how_much_two_sets_disagree() -> None:
    codes = make_pilot_codes(GRID, 32, seed=9)
    rng = np.random.default_rng(10)
    photos = shown(codes, scene(4)) + rng.normal(0.0, 0.05, (32, N))
    paths = scipy.sparse.csr_array(np.where(scene(4) > 0.3, scene(4), 0.0) * (1 - np.eye(N)))
    sigma = 0.05
    found = predict_pilot_errors(codes, photos, paths, 128, sigma=sigma)

    def own(part: slice, series: Floats) -> Floats:
        h = np.where(codes[part], 1.0, -1.0)
        z = 2.0 * (series[part] - series[part].mean(axis=0))
        return np.asarray((h * z).mean(axis=0))

    h = np.where(codes, 1.0, -1.0)
    z = 2.0 * (photos - photos.mean(axis=0))
    indirect = 2.0 * photos.mean(axis=0) - (h * z).mean(axis=0)
    shared = {k: (N / (k - 1) - 1.0) / (N - 1) for k in (8, 128 - 32, 128)}
    wanted: list[float] = []
    for series in (photos, photos - codes @ paths.toarray().T):
        differ = own(slice(4, 12), series) - own(slice(12, 20), series)
        square = max(float(np.mean(differ**2)) - 8.0 / 8 * sigma**2, 0.0) / 2.0
        wanted.append(float(square) / float(np.mean(indirect**2)) / max(shared[8], 0.0))
    assert found.alone == pytest.approx(np.sqrt(wanted[0] * max(shared[128], 0.0)))
    assert found.piloted == pytest.approx(np.sqrt(wanted[1] * max(shared[96], 0.0)))
    assert found.unguided == pytest.approx(np.sqrt(wanted[0] * max(shared[96], 0.0)))
    few = predict_pilot_errors(codes, photos, paths, 40, sigma=sigma)
    assert few.unguided == pytest.approx(np.sqrt(wanted[0] * (N / 7 - 1.0) / (N - 1)))
    assert few.piloted == pytest.approx(np.sqrt(wanted[1] * (N / 7 - 1.0) / (N - 1)))
    assert predict_pilot_errors(codes, photos, paths, 33).alone == pytest.approx(
        predict_pilot_errors(codes, photos, paths, 33).unguided * np.sqrt((N / 32 - 1.0) / (N - 1))
    )  # one code left has all cells in common
    with pytest.raises(ConfigError, match="leaves nothing"):
        predict_pilot_errors(codes, photos, paths, 32)


@pytest.mark.parametrize(("piloted", "pays"), [(0.0699, True), (0.07, False), (0.08, False)])
def test_paths_are_avoided_where_that_is_clearly_better(piloted: float, pays: bool) -> None:
    assert PilotPrediction(alone=1.0, piloted=piloted, unguided=0.1).pays is pays


def test_rows_of_paths_are_solved_as_one_by_one() -> None:
    """After each round the entries of a row are its least squares fit, with the ridge."""
    codes = make_pilot_codes(GRID, 64, seed=11)
    transport = scene(5)
    h, z = to_signs(codes), compute_projections(shown(codes, transport))
    rows = pursuit._Rows(h, z, np.full(N, 1e-3))
    for _ in range(3):
        rows.grow(*pursuit._candidates(rows, pursuit._beside(GRID)))
    for n in range(N):
        cells = rows._cell[n, : rows._used[n]]
        basis = h[:, cells]
        gram = basis.T @ basis + 1e-3 * 64 * np.eye(cells.size)
        value = np.linalg.solve(gram, basis.T @ z[:, n])
        assert cells[0] == n and np.allclose(rows._value[n, : cells.size], value)
        assert np.allclose(rows._rest[n], z[:, n] - basis @ value)
        free = max(64 - cells.size, 1)
        rms = max(np.sqrt(np.sum(rows._rest[n] ** 2) / free), 1e-3)
        scaled = rows.outstanding()[n]
        assert np.allclose(scaled, rows._rest[n] / rms / 8.0, rtol=1e-4, atol=1e-6)
    found = rows.paths().toarray()
    true = transport * (1.0 - np.eye(N))
    assert np.abs(found - true).max() < 0.02 and not np.diag(found).any()
    blocks = pursuit._beside(GRID).toarray()
    r, c = np.divmod(np.arange(N), GRID[1])
    near = (np.abs(r[:, None] - r) <= 1) & (np.abs(c[:, None] - c) <= 1)
    assert np.array_equal(blocks > 0.0, near)


def test_candidates_of_all_blocks_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    codes = make_pilot_codes(GRID, 64, seed=12)
    rows = pursuit._Rows(
        to_signs(codes), compute_projections(shown(codes, scene(6))), np.full(N, 1e-3)
    )
    whole: Any = pursuit._candidates(rows, pursuit._beside(GRID))
    monkeypatch.setattr(pursuit, "ROW_BLOCK", 7)
    again: Any = pursuit._candidates(rows, pursuit._beside(GRID))
    for one, other in zip(whole, again, strict=True):
        assert np.allclose(one, other)
    assert {(r, (r + N // 2 + 3) % N) for r in range(0, N, 3)} <= set(zip(*whole[:2], strict=True))
    assert not any(r == c for r, c in zip(*whole[:2], strict=True))


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


def test_places_around_a_partner_stay_in_the_grid() -> None:
    around = matching._around(np.array([0, N - 1, 2 * GRID[1] + 4]), GRID)
    for cells, (r, c) in zip(around, [(0, 0), (5, 7), (2, 4)], strict=True):
        wanted = [
            (min(max(r + y, 0), 5)) * 8 + min(max(c + x, 0), 7)
            for y in (-1, 0, 1) for x in (-2, -1, 0, 1, 2)
        ]  # fmt: skip
        assert cells.tolist() == wanted
