"""Parts of a matrix are found again, whatever they are, and nothing is found that is not there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.probing.wanted import NearPart, shift_cells
from pdcd.recipes.factored import find_nonnegative_sides
from pdcd.recipes.structure import Structure, find_nearest_product, find_structure

GRID = (9, 12)
N = GRID[0] * GRID[1]
Floats = NDArray[np.float64]


def by_warp(partner: NDArray[np.int64]) -> Floats:
    out = np.zeros((N, N))
    for n, m in enumerate(partner):
        if m >= 0:
            out[n, m] = 1.0
    return out


def near(radius: int) -> Floats:
    return NearPart(GRID, radius).rows(0, N)


def summed(found: Structure) -> Floats:
    """All parts added up, by loops over their definitions."""
    total = np.full((N, N), found.level)
    for weight, radius in found.near:
        total += weight * near(radius)
    for weight, partner in found.matches:
        total += weight * by_warp(partner)
    if found.rest is not None:
        total += found.rest
    total = found.gain[:, None] * total * found.light[None, :]
    if len(found.camera):
        total += found.camera.T @ found.projector
    return np.asarray(total)


@pytest.mark.parametrize("seed", range(6))
def test_random_sums_of_parts_are_found_again(seed: int) -> None:
    """Even light of rank 1 to 3, a band, a warp and a shift, of weights of either sign."""
    rng = np.random.default_rng(seed)
    rank = int(rng.integers(1, 4))
    even = np.ones((N, N)) if rank == 1 else rng.random((N, rank)) @ rng.random((rank, N))
    warp = np.where(rng.random(N) < 0.2, -1, rng.permutation(N))
    weights = np.round(rng.uniform(0.5, 2.0, 3) * rng.choice([-1.0, 1.0], 3), 2)
    band = bool(rng.integers(2))
    shift = (int(rng.integers(-3, 4)), 5)
    matrix = even + weights[0] * by_warp(warp) + weights[1] * by_warp(shift_cells(GRID, shift))
    matrix += weights[2] * near(1) * band
    found = find_structure(matrix, GRID)
    assert found.rest is None
    assert found.near == (((weights[2], 1),) if band else ())
    assert found.level == (1.0 if rank == 1 else 0.0)
    assert len(found.camera) == (0 if rank == 1 else rank)
    assert np.abs(summed(found) - matrix).max() < 1e-6 * np.abs(matrix).max()


def test_gain_light_and_single_precision_hide_nothing() -> None:
    rng = np.random.default_rng(3)
    gain, light = 0.1 + rng.random(N), rng.random(N)
    matrix = gain[:, None] * (1.0 - by_warp(rng.permutation(N))) * light
    found = find_structure(matrix.astype(np.float32).astype(float), GRID)
    assert found.rest is None and len(found.matches) == 1
    np.testing.assert_allclose(found.gain, gain / gain.max(), atol=1e-6)
    np.testing.assert_allclose(found.light, light / light.max(), atol=1e-6)


@pytest.mark.long
def test_noise_stays_in_the_rest_and_numbers_without_structure_are_left_alone() -> None:
    rng = np.random.default_rng(4)
    noise = 1e-3 * rng.standard_normal((N, N))
    warp = rng.permutation(N)
    found = find_structure(1.0 - by_warp(warp) + noise, GRID)
    assert found.level == 1.0 and len(found.matches) == 1 and not found.near
    assert found.matches[0][0] == -1.0
    np.testing.assert_array_equal(found.matches[0][1], warp)
    assert found.rest is not None
    np.testing.assert_allclose(found.rest, noise, atol=1e-6)
    for matrix in (
        noise,
        3.0 + 1e3 * noise,
        np.abs(noise),
        rng.random((N, 20)) @ rng.random((20, N)),
    ):
        whole = find_structure(matrix, GRID)
        assert not whole.found and whole.rest is matrix


@pytest.mark.parametrize(("scattered", "found"), [(2, True), (600, False)])
def test_parts_are_taken_out_where_they_are_half_of_a_matrix(scattered: int, found: bool) -> None:
    """Thirty matched cells of one weight, beside numbers that are all different."""
    rng = np.random.default_rng(7)
    matrix = np.zeros((N, N))
    rows, columns = rng.permutation(N)[:30], rng.permutation(N)[:30]
    matrix.ravel()[rng.permutation(N * N)[:scattered]] = 0.5 + rng.random(scattered)
    matrix[rows, columns] = 0.4
    made = find_structure(matrix, GRID)
    assert made.found == found
    if not found:
        assert made.rest is matrix and made.matches == ()
    np.testing.assert_allclose(made.rows(0, N), matrix, atol=1e-6)


@pytest.mark.parametrize(
    ("weights", "near"),
    [
        ([1.0], ((1.0, 1),)), ([1.0, 0.5], ((0.5, 1), (0.5, 2))),
        ([0.5, 0.5], ((0.5, 2),)), ([1.0, 0.75, 0.5], ()),
    ],
)  # fmt: skip
def test_bands_have_two_weights_at_most(
    weights: list[float], near: tuple[tuple[float, int], ...]
) -> None:
    grid = (14, 16)
    cells = np.arange(224)
    far = np.maximum(
        np.abs(cells[:, None] // 16 - cells // 16), np.abs(cells[:, None] % 16 - cells % 16)
    )
    matrix = 3.0 + np.r_[weights[0], weights, np.zeros(16)][far]
    made = find_structure(matrix, grid)
    assert made.near == near and made.level == 3.0
    np.testing.assert_allclose(made.rows(0, 224), matrix, atol=1e-9)


def test_a_band_whose_weights_scatter_is_no_band() -> None:
    rng = np.random.default_rng(5)
    matrix = 1.0 - near(2) * (1.0 + 0.3 * rng.standard_normal((N, N)))
    found = find_structure(matrix, GRID)
    assert not found.near and found.rest is not None
    np.testing.assert_allclose(summed(found), matrix, atol=1e-9)


@pytest.mark.parametrize("rank", [1, 2, 3])
@pytest.mark.parametrize("kind", ["dense", "half of them 0", "regions"])
def test_exact_sides_without_negative_weights(rank: int, kind: str) -> None:
    """E11, footnote 4: found sides multiply to the matrix, to rounding."""
    rng = np.random.default_rng(rank)
    seen, lit = rng.random((rank, N)), rng.random((rank, N))
    if kind == "half of them 0":
        seen, lit = seen * (rng.random(seen.shape) < 0.5), lit * (rng.random(lit.shape) < 0.5)
    if kind == "regions":
        seen = np.eye(rank)[rng.integers(0, rank, N)].T
    matrix = seen.T @ lit
    mix = rng.standard_normal((rank, rank))
    sides = find_nonnegative_sides(np.asarray(np.linalg.solve(mix.T, seen), float), mix @ lit)
    assert sides is not None
    assert min(side.min() for side in sides) >= 0.0
    np.testing.assert_allclose(sides[0].T @ sides[1], matrix, atol=1e-8 * matrix.max())


def test_where_there_are_no_such_sides_none_are_returned() -> None:
    """The slack matrix of a square has rank 3, and no exact sides of less than 4 products."""
    slack = np.array([[0, 0, 1, 1], [1, 0, 0, 1], [1, 1, 0, 0], [0, 1, 1, 0]], dtype=float)
    u, s, vt = np.linalg.svd(slack)
    assert find_nonnegative_sides((u[:, :3] * s[:3]).T, vt[:3]) is None


def test_scattered_weights_have_one_product_in_common_where_that_is_most_of_them() -> None:
    """By the singular values of the matrix; what is left is left whole."""
    rng = np.random.default_rng(8)
    for matrix in (rng.random((N, N)), -1.0 - 0.3 * rng.standard_normal((N, N))):
        found = find_nearest_product(matrix, GRID)
        sides, values, others = np.linalg.svd(matrix)
        assert found.found and len(found.camera) == 1 and found.level == 0.0
        even = found.camera.T @ found.projector
        np.testing.assert_allclose(even, values[0] * np.outer(sides[:, 0], others[0]), atol=1e-9)
        np.testing.assert_allclose(found.rows(0, N), matrix, atol=1e-12)
    for matrix in (rng.standard_normal((N, N)), np.zeros((N, N)), np.eye(N)):
        assert not find_nearest_product(matrix, GRID).found
    rest = find_nearest_product(matrix, GRID).rest
    assert rest is not None and np.array_equal(rest, matrix)
