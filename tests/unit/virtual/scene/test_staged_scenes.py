"""What scenes that are set up after the paper's figures are about: caustics, mirrors, paint."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.errors import ConfigError
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.displaced import DisplacedEffect
from pdcd.virtual.scene.presets.mirror_ball import find_ray_ends
from pdcd.virtual.scene.presets.objects import Tumbler
from pdcd.virtual.scene.scene import Scene
from pdcd.virtual.scene.texture import average_cells

GRID = (24, 32)


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
