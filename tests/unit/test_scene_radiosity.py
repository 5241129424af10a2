"""Inter-reflection of matte surfaces against sums over bounces and known form factors."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.scene import Relief, Scene, radiosity
from pdcd.scene.effects import Array, coloured_direct
from pdcd.scene.radiosity import closed_exchange, form_kernel, visible


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
    np.testing.assert_allclose(closed_exchange(kernel, area, albedos), total, rtol=1e-11)


def test_closed_form_keeps_the_light_of_a_closed_room_at_albedo_0_999() -> None:
    # In a closed enclosure of even albedo every unit of light is absorbed at last, so that
    # the absorbed share of all arriving light is exactly 1: (1 - rho) sum_i A_i X_ij = 1.
    patches, albedo = 12, 0.999
    kernel = (1.0 - np.eye(patches)) / (patches - 1)
    exchange = closed_exchange(kernel, np.ones(patches), np.full(patches, albedo))
    np.testing.assert_allclose((1.0 - albedo) * exchange.sum(axis=0), 1.0, rtol=1e-10)


def test_effect_is_the_sum_of_two_bounces_and_more_over_patches() -> None:
    grid, rng = (4, 6), np.random.default_rng(2)
    relief, albedo = groove(grid), 0.9 * rng.random((24, 1))
    (effect,) = radiosity("r", relief, albedo, [np.ones(3)])
    # As many patches as cells: the cells themselves exchange light.
    kernel = form_kernel(relief, grid)
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
    (effect,) = radiosity("r", relief, 0.95 * rng.random((221, 1)), [np.ones(3)])
    matrix = effect.dense()
    np.testing.assert_allclose(matrix, matrix.T, rtol=1e-12, atol=1e-18)
    assert matrix.min() >= 0.0
    assert matrix.max() > 0.0


def test_a_flat_surface_does_not_light_itself() -> None:
    (effect,) = radiosity(
        "r", Relief(np.zeros((6, 8)), (1.0, 1.0)), np.ones((48, 1)) * 0.9, [np.ones(3)]
    )
    assert effect.apply(np.ones((1, 48))).max() == 0.0


def test_a_ridge_does_not_light_itself_but_a_groove_does() -> None:
    albedo = np.full((96, 1), 0.8)
    (ridge,) = radiosity("r", groove((8, 12), slope=-1.0), albedo, [np.ones(3)])
    (valley,) = radiosity("r", groove((8, 12), slope=1.0), albedo, [np.ones(3)])
    assert ridge.apply(np.ones((1, 96))).max() == 0.0
    assert valley.apply(np.ones((1, 96))).min() > 0.0


def test_two_far_patches_exchange_by_the_cosine_law() -> None:
    # The two outer walls of a wide groove, seen from points in their middle.
    relief = groove((1, 2), slope=1.0)
    kernel = form_kernel(relief, (1, 2))
    # np.gradient over two cells of equal height sees no slope: nothing is exchanged.
    np.testing.assert_array_equal(kernel, 0.0)
    height = np.array([[4.0, 1.0, 1.0, 4.0]])
    tall = Relief(height, (1.0, 1.0))
    kernel = form_kernel(tall, (1, 4))
    a, b = tall.points[0, 0], tall.points[0, 3]
    normal = tall.normals[0]
    d = b - a
    cosines = (normal[0] @ d / np.linalg.norm(d)) * (-(normal[3] @ d) / np.linalg.norm(d))
    area = 1.0 / tall.cosine[0, 0]
    expected = cosines / (np.pi * (d @ d) + area)
    # Four coinciding points a patch carry a quarter of its area each.
    assert expected == pytest.approx(kernel[0, 3], rel=0.2)
    assert kernel[0, 3] > 0.0


def test_groove_form_factor_is_that_of_two_strips() -> None:
    # Two long strips of equal width that meet at 90 degrees: F = 1 - sin(45 degrees)
    # (crossed strings), here of finite length, so a little less.
    long = Relief(groove((60, 40)).height, (0.5, 0.05))
    kernel = form_kernel(long, (12, 40))
    area = np.full(480, 30 * 2.0 * np.sqrt(2.0) / 480)
    side = np.tile(np.arange(40) < 20, 12)
    middle = np.zeros(480, dtype=bool)
    middle[5 * 40 : 7 * 40] = True
    seen = kernel[side & middle][:, ~side] @ area[~side]
    assert seen.mean() == pytest.approx(1.0 - np.sqrt(0.5), rel=0.08)


def test_form_factors_never_exceed_one() -> None:
    rng = np.random.default_rng(4)
    relief = Relief(5.0 * rng.random((24, 32)), (0.2, 0.2))
    kernel = form_kernel(relief, (12, 16))
    np.testing.assert_allclose(kernel, kernel.T, rtol=1e-14)
    cell = 0.04
    y, x = np.meshgrid(np.arange(24), np.arange(32), indexing="ij")
    patch = (y // 2) * 16 + x // 2
    area = np.bincount(patch.ravel(), (cell / relief.cosine).ravel())
    assert (kernel @ area).max() <= 1.0 + 1e-12


def test_a_wall_between_two_points_hides_them() -> None:
    height = np.array([[2.0, 1.0, 5.0, 1.0, 2.0]])
    relief = Relief(height, (1.0, 1.0))
    seen = visible(relief, relief.points.reshape(-1, 3), steps=16)
    assert not seen[0, 4]
    assert not seen[1, 3]
    assert seen[0, 1]
    assert seen[0, 2]
    np.testing.assert_array_equal(seen, seen.T)
    relief = Relief(np.array([[2.0, 1.0, 0.0, 1.0, 2.0]]), (1.0, 1.0))
    assert visible(relief, relief.points.reshape(-1, 3), steps=16).all()


def test_a_bright_groove_returns_no_more_light_than_it_gets() -> None:
    grid, albedo = (16, 24), np.full((384, 3), 0.999)
    relief = groove(grid)
    effects = radiosity("r", relief, albedo, list(np.eye(3)))
    direct = coloured_direct(albedo * relief.cosine.reshape(-1, 1))
    scene = Scene("groove", grid, (*direct, *effects))
    assert scene.dense().sum(axis=1).max() <= 1.0


def test_indirect_light_is_strongest_where_the_walls_meet() -> None:
    (effect,) = radiosity("r", groove((12, 32)), np.full((384, 1), 0.8), [np.ones(3)])
    line = effect.apply(np.ones((1, 384))).reshape(12, 32)[6]
    assert line[13] > line[8] > line[2]
