"""Scenes with depth before an off-axis rig, against rays solved one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.errors import ConfigError
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.depth import (
    FIELD_HEIGHT,
    FIELD_WIDTH,
    PLANE,
    OffAxisRig,
    make_surface_effects,
)
from pdcd.virtual.scene.displaced import DisplacedEffect
from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.solids import Rectangle, make_box, make_wall

GRID = (6, 8)
GREY = (0.5, 0.5, 0.5)
FRONT = 1.5
SURFACES = (
    *make_box((-0.2, -0.2, FRONT), (0.25, 0.15, 1.9), (0.7, 0.2, 0.1)),
    make_wall(2.7, (2.0, 1.5), GREY),
    Rectangle((-0.9, -0.5, 1.9), (0.5, 0.0, 0.6), (-0.06, 0.6, 0.05), GREY),
)


def solved(start: Array, way: Array) -> tuple[int, float]:
    """The surface that a line meets first, and how far along: three equations a surface."""
    first, nearest = -1, np.inf
    for number, one in enumerate(SURFACES):
        columns = np.stack([way, -np.asarray(one.across), -np.asarray(one.down)], axis=1)
        if abs(np.linalg.det(columns)) < 1e-12:
            continue
        far, u, v = np.linalg.solve(columns, np.asarray(one.corner) - start)
        if far > 1e-9 and 0 <= u <= 1 and 0 <= v <= 1 and far < nearest:
            first, nearest = number, float(far)
    return first, nearest


def point_of(cell: int) -> Array:
    row, col = divmod(cell, GRID[1])
    x = FIELD_WIDTH * ((col + 0.5) / GRID[1] - 0.5)
    return np.array([x, FIELD_HEIGHT * ((row + 0.5) / GRID[0] - 0.5), PLANE])


def test_24_shadows_and_disparities_are_those_of_single_rays() -> None:
    baseline = 0.35
    rig = OffAxisRig(GRID, baseline, SURFACES)
    eye = np.array([baseline, 0.0, 0.0])
    shadows = 0
    for cell in range(GRID[0] * GRID[1]):
        way = point_of(cell) - eye
        surface, far = solved(eye, way)
        assert surface == rig.seen[0][cell]
        point = eye + far * way
        np.testing.assert_allclose(rig.seen[1][cell], point, atol=1e-12)
        # From the projector the same point must be the first thing met.
        _, there = solved(np.zeros(3), point)
        behind = point[:2] * PLANE / point[2]  # where the projector's field has it
        right = (behind[0] / FIELD_WIDTH + 0.5) * GRID[1] - (cell % GRID[1] + 0.5)
        inside = abs(behind[0]) < FIELD_WIDTH / 2
        if there < 1.0 - 1e-6 or not inside:
            shadows += inside
            assert np.isnan(rig.displacement[cell]).all()
        else:
            np.testing.assert_allclose(rig.displacement[cell], [0.0, right], atol=1e-12)
            np.testing.assert_allclose(rig.disparity_cells(float(point[2])), right, atol=1e-12)
            np.testing.assert_allclose(rig.distance(right), point[2], atol=1e-12)
    assert 2 <= shadows <= 20


def test_direct_transport_is_the_share_of_points_lit_by_each_projector_cell() -> None:
    rng = np.random.default_rng(0)
    rows, cols = GRID
    cells, fine = rows * cols, 20
    moved = np.round(rng.uniform(-3, 3, (cells, 2)) * fine) / fine
    moved[rng.random(cells) < 0.2] = np.nan
    albedo = rng.random(cells)
    effect = DisplacedEffect("direct", GRID, albedo, moved)
    expected = np.zeros((cells, cells))
    inner = (np.arange(fine) + 0.5) / fine
    for n in range(cells):
        for y in n // cols + inner + moved[n, 0]:
            for x in n % cols + inner + moved[n, 1]:
                if 0 <= y < rows and 0 <= x < cols:
                    expected[n, int(y) * cols + int(x)] += albedo[n] / fine**2
    np.testing.assert_allclose(effect.dense(), expected, atol=1e-12)
    light = rng.random((3, cells))
    left = rng.random((3, cells))
    np.testing.assert_allclose(effect.apply(light), light @ expected.T, atol=1e-12)
    matrix = left.T @ light
    np.testing.assert_allclose(effect.probe(left, light), (matrix * expected).sum(1), atol=1e-12)
    np.testing.assert_allclose(effect.diagonal(), expected.diagonal(), atol=1e-12)
    seen, lit = np.indices(expected.shape).reshape(2, -1)
    np.testing.assert_allclose(effect.entries(seen, lit), expected.ravel(), atol=1e-12)


def test_paths_between_surfaces_can_be_reversed_where_both_devices_are_in_one_place() -> None:
    rig = OffAxisRig(GRID, 1e-12, SURFACES)
    for effect in make_surface_effects(rig):
        dense = effect.dense()
        # Radiance at n by the flux from m: the other way round it is the same number.
        np.testing.assert_allclose(dense, dense.T, rtol=1e-6, atol=1e-12)
        assert dense.max() > 0.0


def test_surfaces_send_on_no_more_light_than_they_get() -> None:
    """The flux of every projector cell, summed up over all that it reaches in all bounces."""
    closed = (
        make_wall(2.6, (1.5, 1.0), (0.9, 0.9, 0.9)),
        Rectangle((-0.7, -1.0, 1.0), (0.0, 0.0, 1.6), (0.0, 2.0, 0.0), (0.9, 0.9, 0.9)),
        Rectangle((0.7, -1.0, 1.0), (0.0, 0.0, 1.6), (0.0, 2.0, 0.0), (0.9, 0.9, 0.9)),
    )
    rig = OffAxisRig((12, 16), 0.01, closed)
    dense = make_surface_effects(rig)[0].dense()
    # Area of what a camera cell sees, over that of a cell at the plane.
    areas = np.divide(1.0, rig.facing) * FIELD_WIDTH * FIELD_HEIGHT / 192
    flux = FIELD_WIDTH * FIELD_HEIGHT / 192
    leaving = areas @ dense / flux
    assert leaving.max() < 0.9**2 / (1.0 - 0.9)
    assert leaving.max() > 0.05


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("off-axis-box", {"disparity": -50.0}), ("off-axis-box", {"disparity": 50.0}),
        ("off-axis-box", {"disparity": True}), ("off-axis-box", {"seed": 1}),
        ("off-axis-wedge", {"baseline": 0.0}), ("off-axis-shelf", {"baseline": "wide"}),
        ("off-axis-shelf", {"disparity": 0.0}),
    ],
)  # fmt: skip
def test_wrong_options_are_refused(kind: str, options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"\[scene\] options"):
        build_scene(SceneConfig(kind=kind, grid=(12, 16), options=options))


def test_the_boxs_front_has_the_disparity_that_is_asked_for() -> None:
    for disparity in (-1.0, 0.0, 1.5):
        scene = build_scene(
            SceneConfig(kind="off-axis-box", grid=(24, 32), options={"disparity": disparity})
        )
        assert scene.displacement is not None
        assert np.isclose(scene.displacement[:, 1], disparity, atol=1e-9).sum() > 50
