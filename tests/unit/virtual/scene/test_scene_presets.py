"""Preset scenes: sound transport on any grid, and the light that each of them is about."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.errors import ConfigError
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.presets import PRESETS
from pdcd.virtual.scene.scene import Scene

LARGE = pytest.param((24, 32), marks=pytest.mark.long)
GRIDS = [(1, 1), (1, 9), (7, 1), (2, 2), (13, 17), LARGE]


@cache
def preset(kind: str, grid: tuple[int, int] = (48, 64)) -> Scene:
    return build_scene(SceneConfig(kind=kind, grid=grid))


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("kind", sorted(PRESETS))
def test_presets_are_passive_and_reversible_on_any_grid(kind: str, grid: tuple[int, int]) -> None:
    whole = preset(kind, grid).dense()
    assert np.isfinite(whole).all()
    assert whole.min() >= 0.0
    assert whole.sum(axis=1).max() <= 1.0
    np.testing.assert_allclose(whole, whole.transpose(0, 2, 1), rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("kind", sorted(PRESETS))
@pytest.mark.parametrize("options", [{"sed": 1}, {"seed": -1}, {"seed": 1.5}, {"seed": True}])
def test_wrong_options_are_refused(kind: str, options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"\[scene\] options.*sed|\[scene\] options.*seed"):
        build_scene(SceneConfig(kind=kind, options=options))


@pytest.mark.parametrize("kind", sorted(PRESETS))
def test_panels_that_stay_black_make_a_black_photo(kind: str) -> None:
    """An exposure of no refreshes at all: a matrix of rank 0."""
    scene = preset(kind, (13, 17))
    nothing, none = np.zeros((0, scene.cells)), np.zeros(scene.cells)
    photo = scene.photo(nothing, nothing, none, none)
    assert photo.shape == (scene.cells, 3) and not photo.any()
    assert scene.apply(nothing).shape == (0, scene.cells, 3)
