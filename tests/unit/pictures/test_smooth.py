"""The image's own smooth light corrects it, and sharp light is hardly touched."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.pictures.smooth import (
    HALF_LIGHT_CELLS,
    compute_colour_correction,
    compute_smooth_correction,
)
from pdcd.virtual.scene.presets import PRESETS
from tests.places import DATA

Floats = NDArray[np.float64]


def photo(
    transport: Floats, grid: tuple[int, int], family: str, count: int, seed: int
) -> tuple[Floats, Floats, Floats, float]:
    """Image, mask side, projector side and weight of one indirect photo."""
    codes = make_codes(family, grid, count, dual="complement", seed=seed)
    left, right = codes.dual.astype(np.float64), codes.primal.astype(np.float64)
    cells = len(transport)
    weight = float((left.T @ right).sum() / (cells * (cells - 1)))
    return ((left.T @ right) / weight * transport).sum(axis=1), left, right, weight


def errors(
    transport: Floats, grid: tuple[int, int], family: str, count: int, seed: int
) -> tuple[float, float]:
    """RMS error over the RMS of the truth, before and after the correction."""
    image, left, right, weight = photo(transport, grid, family, count, seed)
    truth = transport.sum(axis=1) - np.diag(transport)
    better = image + compute_smooth_correction(left, right, weight, image, grid)
    scale = np.sqrt(np.mean(truth**2))
    return tuple(float(np.sqrt(np.mean((i - truth) ** 2)) / scale) for i in (image, better))  # type: ignore[return-value]


def spread(kind: str, grid: tuple[int, int]) -> Floats:
    """Transport x_n k(d) x_m of the two forms that are looked for, x smooth: (N, N)."""
    row, col = np.divmod(np.arange(grid[0] * grid[1]), grid[1])
    part = 1.0 + 0.5 * np.cos(row / 5.0) * np.sin(col / 7.0)
    squared = (row[:, None] - row) ** 2.0 + (col[:, None] - col) ** 2.0
    falling = (
        np.ones_like(squared) if kind == "even" else 1.0 / (1.0 + squared / HALF_LIGHT_CELLS**2)
    )
    np.fill_diagonal(falling, 0.0)
    transport: Floats = part[:, None] * falling * part
    return transport


@pytest.mark.parametrize(("kind", "left"), [("even", 0.3), ("near", 0.35)])
@pytest.mark.parametrize(
    ("family", "count"), [("bernoulli", 32), ("hadamard", 8), ("hadamard", 64)]
)
def test_light_of_the_assumed_forms_is_found_and_corrected(
    kind: str, left: float, family: str, count: int
) -> None:
    grid = (24, 32)
    pairs = [errors(spread(kind, grid), grid, family, count, seed) for seed in range(2)]
    before, after = np.mean(pairs, axis=0)
    assert after < left * before


@settings(max_examples=15)
@given(rows=st.integers(1, 9), cols=st.integers(1, 9), seed=st.integers(0, 999))
def test_any_image_on_any_grid_gets_a_finite_correction(rows: int, cols: int, seed: int) -> None:
    """Never more than what would be missing if all light were of both forms."""
    rng = np.random.default_rng(seed)
    image = rng.exponential(size=rows * cols) * (rng.random(rows * cols) < 0.7)
    lit = rng.random((8, rows * cols)) < 0.5
    left, right = (~lit).astype(np.float64), lit.astype(np.float64)
    found = compute_smooth_correction(left, right, 2.0, image, (rows, cols))
    assert np.isfinite(found).all()
    assert np.all(np.abs(found) <= 20.0 * image.max())


def test_weights_of_single_cells_do_as_one_weight_where_they_are_equal() -> None:
    grid = (9, 11)
    image, left, right, weight = photo(spread("near", grid), grid, "hadamard", 8, 3)
    one = compute_smooth_correction(left, right, weight, image, grid)
    many = compute_smooth_correction(left, right, np.full(99, weight), image, grid)
    assert np.array_equal(one, many)
    # A cell whose rows were seen for twice the time, and was divided by that, misses the same.
    twice = np.where(np.arange(99) % 2 == 0, 2.0, 1.0)
    again = compute_smooth_correction(left * twice, right, twice * weight, image, grid)
    assert np.allclose(again, one, rtol=1e-9, atol=1e-12)


@cache
def preset_errors(name: str, family: str, count: int, seed: int) -> tuple[float, float]:
    """The same for a preset of 48 x 64 cells, in all its colours."""
    scene = PRESETS[name]((48, 64), {})
    lit = make_codes(family, scene.grid, count, dual="complement", seed=seed).primal.astype(
        np.float64
    )
    left, cells = 1.0 - lit, lit.shape[1]
    weight = float(np.sum(left.sum(axis=1) * lit.sum(axis=1))) / (cells * (cells - 1))
    image = scene.photo(left, lit, np.zeros(cells), left.sum(axis=0)) / weight
    more = compute_colour_correction(left, lit, weight, image, scene.grid)
    truth, scale = scene.split()[1], np.sqrt(np.mean(scene.split()[1] ** 2))
    found = (image, image + more)
    return tuple(float(np.sqrt(np.mean((i - truth) ** 2)) / scale) for i in found)  # type: ignore[return-value]


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "count", "gain"),
    [
        ("wax-disk", 8, 60.0), ("wax-disk", 128, 200.0), ("wax-disk", 512, 120.0),
        ("milky-bottle", 8, 120.0), ("milky-bottle", 128, 200.0), ("milky-bottle", 512, 250.0),
        ("open-book", 128, 45.0),
    ],
)  # fmt: skip
def test_corrected_codes_beat_bernoulli_by_the_promised_factor(
    name: str, count: int, gain: float
) -> None:
    plain = np.mean([preset_errors(name, "bernoulli", count, seed)[0] for seed in range(2)])
    better = np.mean([preset_errors(name, "hadamard", count, seed)[1] for seed in range(2)])
    assert better < plain / gain


@pytest.mark.long
@pytest.mark.parametrize("count", [8, 128, 512])
@pytest.mark.parametrize("name", list(PRESETS))
def test_no_preset_gets_worse(name: str, count: int) -> None:
    for seed in range(2):
        before, after = preset_errors(name, "hadamard", count, seed)
        assert after < 1.001 * before


@pytest.mark.parametrize("count", [8, 128])
def test_a_path_traced_corner_errs_less(count: int) -> None:
    with np.load(DATA / "corner_32x24.npz") as file:
        transport = np.asarray(file["transport"], dtype=np.float64)
    pairs = [errors(transport, (24, 32), "hadamard", count, seed) for seed in range(2)]
    before, after = np.mean(pairs, axis=0)
    assert after < (0.999 if count == 8 else 0.975) * before


def test_sharp_paths_are_hardly_touched() -> None:
    cells = 24 * 32
    transport = np.eye(cells)[np.random.default_rng(1).permutation(cells)]
    before, after = errors(transport, (24, 32), "hadamard", 64, 0)
    assert after < 1.01 * before


@pytest.mark.parametrize(("count", "seed"), [(8, 0), (32, 1), (128, 2)])
def test_texture_is_not_taken_for_the_pattern_of_the_codes(count: int, seed: int) -> None:
    """Sharp and near light between cells whose brightness is drawn at random: nothing to learn,
    and codes that are nearly exact already."""
    grid = (24, 32)
    rng = np.random.default_rng(seed)
    row, col = np.divmod(np.arange(768), 32)
    mirror = np.eye(768)[row * 32 + 31 - col]
    near = np.exp(-((row[:, None] - row) ** 2.0 + (col[:, None] - col) ** 2.0) / 9.0)
    albedo = rng.uniform(0.1, 1.0, 768)
    for paths in (mirror, near - np.eye(768)):
        before, after = errors(albedo[:, None] * paths * albedo, grid, "hadamard", count, seed)
        assert after < 1.1 * before


def test_a_black_or_negative_image_needs_no_correction() -> None:
    codes = make_codes("hadamard", (4, 5), 8, dual="complement").primal.astype(np.float64)
    for image in (np.zeros(20), np.full(20, -0.1)):
        assert not compute_smooth_correction(1.0 - codes, codes, 2.0, image, (4, 5)).any()


def test_exact_codes_leave_nothing_to_correct() -> None:
    """More codes than cells: every pair of cells has the same weight."""
    image, left, right, weight = photo(spread("near", (4, 5)), (4, 5), "hadamard", 32, 0)
    assert np.abs(compute_smooth_correction(left, right, weight, image, (4, 5))).max() < 1e-12


@pytest.mark.parametrize("step", [(0, 1), (0, -1), (1, 0), (-1, 0), (1, -1)])
def test_light_that_no_cell_sees_from_one_side_is_not_corrected(step: tuple[int, int]) -> None:
    """As with quarter windows out of register: all cells miss alike what lies to that side."""
    grid = (6, 8)
    row, col = np.divmod(np.arange(48), grid[1])
    seen = np.ones((48, 48))
    seen[(row[:, None] + step[0] == row) & (col[:, None] + step[1] == col)] = 0.0
    image = np.random.default_rng(2).uniform(0.5, 1.5, 48)
    near_alone = np.array([0.0, 1.0])
    more = compute_smooth_correction(np.eye(48), seen, 1.0, image, grid, shares=near_alone)
    np.testing.assert_allclose(more, 0.0, atol=1e-12)
