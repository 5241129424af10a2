"""Scenes that are set up after the paper's figures: sound transport, and what each is about."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.errors import ConfigError
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.displaced import DisplacedEffect
from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.presets import STAGED
from pdcd.virtual.scene.presets.mirror_ball import find_ray_ends
from pdcd.virtual.scene.presets.objects import Tumbler
from pdcd.virtual.scene.scene import Scene
from pdcd.virtual.scene.texture import average_cells
from tests.textured import detailed

GRID = (24, 32)
CELL_MEANS = {
    "still-life": (0.05, 0.20),
    "ball-wax-book": (0.05, 0.10),
    "chart-in-milk": (0.03, 0.03),
    "glass-and-balls": (0.03, 0.08),
}
"""Most that direct and indirect light in detail may differ from the cells' own, RMS over RMS."""


@cache
def staged(kind: str, grid: tuple[int, int] = GRID) -> Scene:
    return build_scene(SceneConfig(kind=kind, grid=grid))


@pytest.mark.parametrize(
    "grid", [(1, 1), (7, 1), (12, 16), pytest.param(GRID, marks=pytest.mark.long)]
)
@pytest.mark.parametrize("kind", sorted(STAGED))
def test_no_point_gives_back_more_than_it_gets_and_paths_go_both_ways(
    kind: str, grid: tuple[int, int]
) -> None:
    whole = staged(kind, grid).dense()
    assert np.isfinite(whole).all() and whole.min() >= 0.0
    assert whole.sum(axis=1).max() <= 1.0
    np.testing.assert_allclose(whole, whole.transpose(0, 2, 1), rtol=1e-12, atol=1e-16)


@pytest.mark.long
@pytest.mark.parametrize("kind", sorted(STAGED))
def test_energy_and_texture_at_the_grid_of_the_figures(kind: str) -> None:
    scene = staged(kind, (48, 64))
    assert scene.white().max() <= 1.0
    assert scene.split()[1].mean() > 0.03
    assert scene.textures is not None
    x, y = np.meshgrid((np.arange(512) + 0.5) / 512, (np.arange(384) + 0.5) / 384)
    points = np.stack([x, y], axis=-1)
    for texture, cells, limit in zip(scene.textures, scene.split(), CELL_MEANS[kind], strict=True):
        assert texture.shape == (768, 1024, 3) and texture.min() > 0.0
        light = average_cells(detailed(cells, scene.grid, texture, points), scene.grid)
        assert np.sqrt(np.mean((light - cells) ** 2) / np.mean(cells**2)) < limit


@pytest.mark.parametrize("kind", sorted(STAGED))
def test_the_seed_makes_the_scene_and_other_options_are_refused(kind: str) -> None:
    def white(options: dict[str, Any]) -> Array:
        return build_scene(SceneConfig(kind=kind, grid=(6, 8), options=options)).white()

    assert not np.array_equal(white({"seed": 0}), white({"seed": 1}))
    with pytest.raises(ConfigError, match="sed"):
        white({"sed": 1})


def test_the_caustic_of_a_round_glass_is_that_of_single_mirrored_rays() -> None:
    """Without waves, at some places: a ray, its mirror image, and the table, each in space."""
    glass = Tumbler(0.1, 0.2, 0.5, 0.6)
    tilt = np.arcsin(0.4)
    right, towards = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])
    down = np.array([0.0, -1.0, 0.0])
    ray = -np.cos(tilt) * towards + np.sin(tilt) * down
    picture_down = np.cos(tilt) * down + np.sin(tilt) * towards
    for across, level in ((0.3, 0.2), (-0.7, 0.4), (0.0, 0.1)):
        depth = np.sqrt(1.0 - across**2)
        wall = glass.radius * (across * right - depth * towards) - level * down
        normal = -np.array([across, 0.0, depth])
        out = ray - 2.0 * (ray @ normal) * normal
        end = wall + out * (wall @ -down) / (out @ down)
        x, y = glass.x + wall @ right, glass.y + wall @ picture_down
        there, to_x, to_y = glass.caustic(np.array([x]), np.array([y]), waves=0.0)
        assert there.all()
        want = glass.x + end @ right, glass.y + end @ picture_down
        np.testing.assert_allclose([to_x[0], to_y[0]], want, atol=1e-12)


def test_rays_end_where_small_steps_find_the_room() -> None:
    room = ((-0.5, 0.0, 0.0), (-1.0, 0.0, 1.5), (-1.2, 0.9, 0.0))
    rng = np.random.default_rng(0)
    start = np.stack([*rng.uniform(-0.5, 0.5, (2, 40)), np.full(40, 0.4)], axis=-1)
    ray = rng.normal(size=(40, 3))
    x, y = find_ray_ends(room, start, ray)
    for number in range(40):
        steps = np.linspace(0.0, 6.0, 60001)[:, None] * ray[number] + start[number]
        ground = np.max([h + a * steps[:, 0] + b * steps[:, 1] for h, a, b in room], axis=0)
        below = np.flatnonzero(steps[:, 2] < ground)
        if len(below):
            np.testing.assert_allclose([x[number], y[number]], steps[below[0], :2], atol=1e-3)
        else:
            far = np.hypot(x[number] - start[number, 0], y[number] - start[number, 1])
            assert not np.isfinite(far) or far > 5.9 * np.hypot(*ray[number, :2])


def test_paint_on_the_box_takes_light_and_unpainted_it_is_as_it_was() -> None:
    def box(**options: Any) -> Scene:
        return build_scene(SceneConfig(kind="off-axis-box", grid=GRID, options=options))

    plain, painted = box(), box(painted=True)
    assert plain.texture is None and painted.texture is not None
    np.testing.assert_array_equal(box(painted=False).dense(), plain.dense())
    share = painted.dense().sum(axis=2) / np.maximum(plain.dense().sum(axis=2), 1e-12)
    assert 0.1 < share.min() < 0.5 and share.max() <= 1.0 + 1e-12
    direct = [e for e in painted.effects if isinstance(e, DisplacedEffect)]
    light = sum(e.apply(np.ones((1, plain.cells)))[0][:, None] * e.tint for e in direct)
    lit = np.asarray(light)[:, 0] > 0.02
    means = average_cells(painted.texture, GRID)
    ratio = np.asarray(light)[lit] / means[lit]
    np.testing.assert_allclose(np.median(ratio, axis=0), 1.0, rtol=0.03)
    with pytest.raises(ConfigError, match="painted"):
        box(painted=1)
