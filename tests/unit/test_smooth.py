"""The image's own smooth light corrects it, and sharp light is hardly touched."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pdcd.codes import make_codes
from pdcd.smooth import REACH, SHARE, smooth_correction

Floats = NDArray[np.float64]
DATA = Path(__file__).parents[1] / "data"


def kernel(grid: tuple[int, int]) -> Floats:
    """1 / (1 + d / REACH) between all pairs of cells, 0 on the diagonal: (N, N)."""
    row, col = np.divmod(np.arange(grid[0] * grid[1]), grid[1])
    distance = np.sqrt((row[:, None] - row) ** 2.0 + (col[:, None] - col) ** 2.0)
    falling: Floats = 1.0 / (1.0 + distance / REACH)
    np.fill_diagonal(falling, 0.0)
    return falling


def photo(
    transport: Floats, grid: tuple[int, int], family: str, count: int, seed: int
) -> tuple[Floats, Floats, Floats, float]:
    """Image, mask side, projector side and weight of one indirect photo."""
    codes = make_codes(family, grid, count, dual="complement", seed=seed)
    left, right = codes.dual().astype(np.float64), codes.primal().astype(np.float64)
    cells = len(transport)
    weight = float((left.T @ right).sum() / (cells * (cells - 1)))
    return ((left.T @ right) / weight * transport).sum(axis=1), left, right, weight


def errors(
    transport: Floats, grid: tuple[int, int], family: str, count: int, seed: int
) -> tuple[float, float]:
    """RMS error over the RMS of the truth, before and after the correction."""
    image, left, right, weight = photo(transport, grid, family, count, seed)
    truth = transport.sum(axis=1) - np.diag(transport)
    better = image + smooth_correction(left, right, weight, image, grid)
    scale = np.sqrt(np.mean(truth**2))
    return tuple(float(np.sqrt(np.mean((i - truth) ** 2)) / scale) for i in (image, better))  # type: ignore[return-value]


@settings(deadline=None, derandomize=True, max_examples=25)
@given(rows=st.integers(2, 9), cols=st.integers(2, 9), seed=st.integers(0, 999))
def test_light_of_the_assumed_form_is_corrected_by_its_share(
    rows: int, cols: int, seed: int
) -> None:
    """For T = x k x the missing light is known in closed form, and SHARE of it comes back."""
    grid = (rows, cols)
    part = np.random.default_rng(seed).uniform(0.8, 1.2, rows * cols)
    transport = part[:, None] * kernel(grid) * part
    _, left, right, weight = photo(transport, grid, "bernoulli", 16, seed)
    truth = transport.sum(axis=1)
    missing = truth - ((left.T @ right) / weight * transport).sum(axis=1)
    found = smooth_correction(left, right, weight, truth, grid)
    assert np.allclose(found, SHARE * missing, rtol=0.0, atol=0.02 * np.abs(missing).max())


@pytest.mark.parametrize("count", [8, 32, 128, 512])
def test_a_path_traced_corner_errs_less(count: int) -> None:
    with np.load(DATA / "corner_32x24.npz") as file:
        transport = np.asarray(file["transport"], dtype=np.float64)
    pairs = [errors(transport, (24, 32), "hadamard", count, seed) for seed in range(2)]
    before, after = np.mean(pairs, axis=0)
    assert after < 0.97 * before


def test_sharp_paths_are_hardly_touched() -> None:
    cells = 24 * 32
    transport = np.eye(cells)[np.random.default_rng(1).permutation(cells)]
    before, after = errors(transport, (24, 32), "hadamard", 64, 0)
    assert after < 1.01 * before


def test_a_black_or_negative_image_needs_no_correction() -> None:
    codes = make_codes("hadamard", (4, 5), 8, dual="complement").primal().astype(np.float64)
    for image in (np.zeros(20), np.full(20, -0.1)):
        assert not smooth_correction(1.0 - codes, codes, 2.0, image, (4, 5)).any()


def test_exact_codes_leave_nothing_to_correct() -> None:
    """More codes than cells: every pair of cells has the same weight."""
    image, left, right, weight = photo(kernel((4, 5)), (4, 5), "hadamard", 32, 0)
    assert np.abs(smooth_correction(left, right, weight, image, (4, 5))).max() < 1e-12
