"""Inter-reflection of matte surfaces against sums over bounces and known form factors."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.radiosity import (
    Relief,
    compute_form_kernel,
    find_clear_pairs,
    make_radiosity_effects,
    solve_exchange,
)


def groove(grid: tuple[int, int], slope: float = 1.0) -> Relief:
    """A V-groove along the rows, one unit wide on either side."""
    pitch = (2.0 / grid[0], 2.0 / grid[1])
    x = pitch[1] * (np.arange(grid[1]) - 0.5 * (grid[1] - 1))
    return Relief(np.broadcast_to(slope * np.abs(x), grid).copy(), pitch)


def random_enclosure(patches: int) -> tuple[Array, Array]:
    """A symmetric kernel and areas with form factors that sum to 1 at the fullest patch."""
    rng = np.random.default_rng(1)
    kernel, area = rng.random((patches, patches)), 0.5 + rng.random(patches)
    kernel = kernel + kernel.T
    np.fill_diagonal(kernel, 0.0)
    return kernel / (kernel @ area).max(), area


@pytest.mark.parametrize(("albedo", "bounces"), [(0.0, 2), (0.5, 60), (0.9, 400), (0.999, 40_000)])
def test_closed_form_is_the_sum_over_bounces(albedo: float, bounces: int) -> None:
    kernel, area = random_enclosure(9)
    albedos = np.full(9, albedo)
    total, bounce = np.zeros_like(kernel), kernel.copy()
    for _ in range(bounces):
        total += bounce
        bounce = kernel @ ((area * albedos)[:, None] * bounce)
    np.testing.assert_allclose(solve_exchange(kernel, area, albedos), total, rtol=1e-11)


def test_effect_is_the_sum_of_two_bounces_and_more_over_patches() -> None:
    grid, rng = (4, 6), np.random.default_rng(2)
    relief, albedo = groove(grid), 0.9 * rng.random((24, 1))
    (effect,) = make_radiosity_effects("r", relief, albedo, [np.ones(3)])
    # As many patches as cells: the cells themselves exchange light.
    kernel = compute_form_kernel(relief, grid)
    cell = relief.pitch[0] * relief.pitch[1]
    rho = albedo[:, 0]
    leaving = cell * np.diag(rho)  # flux that leaves after the first bounce, for each lit cell
    total = np.zeros((24, 24))
    for _ in range(400):
        arriving = kernel @ leaving
        total += rho[:, None] * arriving
        leaving = (rho * (cell / relief.cosine).ravel())[:, None] * arriving
    np.testing.assert_allclose(effect.dense(), total, rtol=1e-10, atol=1e-16)


def test_paths_can_be_reversed_to_the_last_bit() -> None:
    rng = np.random.default_rng(3)
    relief = Relief(rng.random((13, 17)), (0.1, 0.15))
    (effect,) = make_radiosity_effects("r", relief, 0.95 * rng.random((221, 1)), [np.ones(3)])
    matrix = effect.dense()
    np.testing.assert_allclose(matrix, matrix.T, rtol=1e-12, atol=1e-18)
    assert matrix.min() >= 0.0
    assert matrix.max() > 0.0


def test_a_ridge_does_not_light_itself_but_a_groove_does() -> None:
    albedo = np.full((96, 1), 0.8)
    (ridge,) = make_radiosity_effects("r", groove((8, 12), slope=-1.0), albedo, [np.ones(3)])
    (valley,) = make_radiosity_effects("r", groove((8, 12), slope=1.0), albedo, [np.ones(3)])
    assert ridge.apply(np.ones((1, 96))).max() < 1e-15
    assert valley.apply(np.ones((1, 96))).min() > 0.0


def test_two_far_patches_exchange_by_the_cosine_law() -> None:
    tall = Relief(np.array([[4.0, 1.0, 1.0, 4.0]]), (1.0, 1.0))
    start, end = tall.points[0, 0], tall.points[0, 3]
    normal, way = tall.normals[0], end - start
    cosines = (normal[0] @ way) * -(normal[3] @ way) / (way @ way)
    # One cell a patch: its four points coincide and carry a quarter of its area each.
    quarter = 0.25 / tall.cosine[0, 0]
    kernel = compute_form_kernel(tall, (1, 4))
    assert cosines > 0.0
    assert kernel[0, 3] == pytest.approx(cosines / (np.pi * (way @ way) + quarter), rel=1e-12)


@pytest.mark.long
def test_groove_form_factor_is_that_of_two_strips() -> None:
    # Two long strips of equal width that meet at 90 degrees: F = 1 - sin(45 degrees) by crossed
    # strings; here of length 6, seen from the middle.
    pitch = 1.0 / 24.0
    height = np.abs(pitch * (np.arange(48) - 23.5)) * np.ones((144, 1))
    kernel = compute_form_kernel(Relief(height, (pitch, pitch)), (36, 12))
    area = np.sqrt(2.0) / 36.0
    side = np.tile(np.arange(12) < 6, 36)
    middle = np.repeat(np.abs(np.arange(36) - 17.5) < 3, 12)
    seen = kernel[side & middle][:, ~side].sum(axis=1) * area
    assert seen.mean() == pytest.approx(1.0 - np.sqrt(0.5), rel=0.08)


def test_form_factors_never_exceed_one() -> None:
    rng = np.random.default_rng(4)
    relief = Relief(5.0 * rng.random((24, 32)), (0.2, 0.2))
    kernel = compute_form_kernel(relief, (12, 16))
    np.testing.assert_allclose(kernel, kernel.T, rtol=1e-14)
    cell = 0.04
    y, x = np.meshgrid(np.arange(24), np.arange(32), indexing="ij")
    patch = (y // 2) * 16 + x // 2
    area = np.bincount(patch.ravel(), (cell / relief.cosine).ravel())
    assert (kernel @ area).max() <= 1.0 + 1e-12


def test_a_wall_between_two_points_hides_them() -> None:
    relief = Relief(np.array([[2.0, 1.0, 5.0, 1.0, 2.0]]), (1.0, 1.0))
    points = relief.points[0]
    pairs = [(0, 4), (1, 3), (0, 1), (0, 2), (2, 4)]
    start, end = (points[[pair[k] for pair in pairs]] for k in (0, 1))
    clear = find_clear_pairs(relief, start, end)
    np.testing.assert_array_equal(clear, [False, False, True, True, True])
    dip = Relief(np.array([[2.0, 1.0, 0.0, 1.0, 2.0]]), (1.0, 1.0))
    points = dip.points[0]
    assert find_clear_pairs(dip, points[[0, 1, 0]], points[[4, 3, 2]]).all()


def test_a_wall_stops_the_exchange_between_what_it_parts() -> None:
    height = np.array([4.0, 2.0, 0.0, 0.0, 9.0, 0.0, 0.0, 2.0, 4.0]) * np.ones((3, 1))
    parted = compute_form_kernel(Relief(height, (1.0, 1.0)), (3, 9))
    height[:, 4] = 0.0
    joined = compute_form_kernel(Relief(height, (1.0, 1.0)), (3, 9))
    assert joined[1, 7] > 0.0
    assert parted[1, 7] == 0.0
    assert parted[1, 3] > 0.0


@cache
def groove_kernel(grid: tuple[int, int]) -> Array:
    return compute_form_kernel(groove(grid), grid)


@pytest.mark.long
@pytest.mark.parametrize("albedo", [0.0, 0.5, 0.999, None])
def test_light_is_absorbed_or_escapes_and_nothing_else(albedo: float | None) -> None:
    relief = groove((16, 24))
    kernel = groove_kernel((16, 24))
    area = ((2.0 / 16) * (2.0 / 24) / relief.cosine).ravel()
    rng = np.random.default_rng(5)
    rho = rng.random(384) if albedo is None else np.full(384, albedo)
    arriving = solve_exchange(kernel, area, rho)  # on i, for unit flux that leaves j
    leaving = np.eye(384) + (rho * area)[:, None] * arriving
    absorbed = ((1.0 - rho) * area) @ arriving
    escaped = (1.0 - kernel @ area) @ leaving
    np.testing.assert_allclose(absorbed + escaped, 1.0, rtol=1e-10)
