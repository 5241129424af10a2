"""Rectangles that rays meet, light that comes from beside, cards and tables of scenes, by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import DEFAULT_GRID, SceneConfig
from pdcd.errors import ConfigError
from pdcd.virtual.scene.build import ALBEDO, build_scene, make_card
from pdcd.virtual.scene.depth import OffAxisRig
from pdcd.virtual.scene.kernel import make_gaussian_kernel
from pdcd.virtual.scene.milk import make_milk_effects
from pdcd.virtual.scene.solids import Rectangle, find_first_hit, make_wall

GREY = (0.5, 0.5, 0.5)
SQUARE = Rectangle((0.0, 0.0, 2.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), GREY)


def met(start: tuple[float, float, float], way: tuple[float, float, float]) -> float:
    return float(SQUARE.met(np.array([start]), np.array([way]))[0])


def test_nothing_is_seen_beside_all_surfaces() -> None:
    rig = OffAxisRig((4, 8), 0.2, (make_wall(1.0, (0.15, 9.0), GREY),))
    which, _ = rig.seen
    seen = which >= 0
    assert 0 < seen.sum() < 32
    assert not rig.albedo[~seen].any() and (rig.albedo[seen] == 0.5).all()
    assert not rig.facing[~seen].any() and np.isnan(rig.displacement[~seen]).all()


@pytest.mark.parametrize(
    ("options", "albedo"), [({}, ALBEDO), ({"albedo": 1.0}, 1.0), ({"albedo": 1}, 1.0)]
)
def test_a_card_is_flat_and_matt(options: dict[str, Any], albedo: float) -> None:
    scene = make_card((2, 3), options)
    direct, indirect = scene.split()
    np.testing.assert_array_equal(direct, np.full((6, 3), albedo))
    assert not indirect.any() and (scene.name, scene.grid) == ("card", (2, 3)) and ALBEDO == 0.9


@pytest.mark.parametrize(
    "options",
    [{"albedo": 0.0}, {"albedo": 1.001}, {"albedo": True}, {"albedo": "x"}, {"colour": 0.5}],
)
def test_a_card_of_no_albedo_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="options of 'card'"):
        make_card((2, 3), options)


def test_a_table_of_a_scene_makes_it() -> None:
    plain = build_scene(SceneConfig(kind="card"))
    assert plain.grid == DEFAULT_GRID and plain.ambient is None
    lit = build_scene(SceneConfig(kind="card", grid=(2, 3), ambient=0.25))
    assert lit.ambient is not None and lit.grid == (2, 3)
    np.testing.assert_array_equal(lit.ambient, np.full((6, 3), 0.25))
    with pytest.raises(ConfigError, match="reads no file"):
        build_scene(SceneConfig(kind="card", path="x.npz"))


def test_milk_is_three_effects_of_known_strength() -> None:
    grid, depth = (1, 3), np.array([0.0, 0.5, 1.0])
    albedo = np.tile([0.2, 0.5, 0.8], (3, 1))
    tint = np.array([1.0, 0.9, 0.8])
    *direct, blur, veil = make_milk_effects(grid, (1.0, 1.0), depth, albedo, sigma=0.7, tint=tint)
    scattered = 1.0 - np.exp(-2.0 * depth)
    for channel, one in enumerate(direct):
        np.testing.assert_allclose(one.diagonal(), albedo[:, channel] * np.exp(-2.0 * depth))
    gate = np.sqrt(0.3 * scattered * 0.5)
    line = make_gaussian_kernel(grid, (1.0, 1.0), 0.7)[0]
    spread = np.array([[line[2 + n - m] for m in range(3)] for n in range(3)])
    np.testing.assert_allclose(blur.dense(), gate[:, None] * spread * gate)
    np.testing.assert_allclose(veil.dense(), 0.6 * np.outer(scattered, scattered / scattered.sum()))
    assert np.array_equal(blur.tint, tint) and np.array_equal(veil.tint, tint)
    clear_water = make_milk_effects(grid, (1.0, 1.0), 0.0 * depth, albedo, sigma=0.7, tint=tint)
    assert len(clear_water) == 3


def test_the_first_of_several_surfaces_is_seen() -> None:
    near, far = make_wall(2.0, (0.5, 0.5), GREY), make_wall(4.0, (2.0, 2.0), GREY)
    way = np.array([[0.0, 0.0, 1.0], [0.4, 0.0, 1.0], [0.9, 0.0, 1.0]])
    which, points = find_first_hit([far, near], np.zeros(3), way)
    assert which.tolist() == [1, 0, -1]
    np.testing.assert_allclose(points[:2], [[0.0, 0.0, 2.0], [1.6, 0.0, 4.0]])
    assert np.isnan(points[2]).all()


def test_a_rectangle_is_met_ahead_only_and_from_either_side() -> None:
    assert met((0.5, 0.5, 0.0), (0.0, 0.0, 4.0)) == pytest.approx(0.5)
    assert met((0.5, 0.5, 3.0), (0.0, 0.0, -1.0)) == pytest.approx(1.0)
    assert met((0.5, 0.5, 3.0), (0.0, 0.0, 1.0)) == np.inf
    assert met((0.5, 0.5, 2.0), (0.0, 0.0, 1.0)) == np.inf  # it starts there
    assert met((0.5, 0.5, 2.0), (1.0, 0.0, 0.0)) == np.inf  # within its plane
    assert met((0.0, 0.5, 0.0), (0.5, 0.0, 1.0)) == pytest.approx(2.0)
