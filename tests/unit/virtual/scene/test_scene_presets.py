"""All preset scenes: sound transport on any grid, and options that are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.errors import ConfigError
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.presets import PRESETS, STAGED
from pdcd.virtual.scene.scene import Scene

KINDS = sorted([*PRESETS, *STAGED])
LARGE = pytest.param((24, 32), marks=pytest.mark.long)


def preset(kind: str, grid: tuple[int, int], **options: Any) -> Scene:
    return build_scene(SceneConfig(kind=kind, grid=grid, options=options))


@pytest.mark.parametrize("grid", [(1, 1), (1, 9), (7, 1), (13, 17), LARGE])
@pytest.mark.parametrize("kind", KINDS)
def test_no_point_gives_back_more_than_it_gets_and_paths_go_both_ways(
    kind: str, grid: tuple[int, int]
) -> None:
    whole = preset(kind, grid).dense()
    assert np.isfinite(whole).all() and whole.min() >= 0.0
    assert whole.sum(axis=1).max() <= 1.0
    np.testing.assert_allclose(whole, whole.transpose(0, 2, 1), rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("kind", KINDS)
def test_the_seed_makes_the_scene_and_other_options_are_refused(kind: str) -> None:
    first, other = (preset(kind, (6, 8), seed=seed).white() for seed in (0, 1))
    assert not np.array_equal(first, other)
    with pytest.raises(ConfigError, match=r"\[scene\] options.*sed"):
        preset(kind, (6, 8), sed=1)


@pytest.mark.parametrize("seed", [-1, 1.5, True])
def test_wrong_seeds_are_refused(seed: Any) -> None:
    with pytest.raises(ConfigError, match=r"\[scene\] options.*seed"):
        preset("open-book", (6, 8), seed=seed)


@pytest.mark.parametrize("kind", ["disco-ball", "milky-bottle"])
def test_panels_that_stay_black_make_a_black_photo(kind: str) -> None:
    """An exposure of no refreshes at all: a matrix of rank 0."""
    scene = preset(kind, (13, 17))
    nothing, none = np.zeros((0, scene.cells)), np.zeros(scene.cells)
    photo = scene.photo(nothing, nothing, none, none)
    assert photo.shape == (scene.cells, 3) and not photo.any()
    assert scene.apply(nothing).shape == (0, scene.cells, 3)
