"""Presets in detail: drawn when asked for, true to their cells, with text that can be read."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.presets import PRESETS, STAGED, detail
from pdcd.virtual.scene.scene import Scene
from pdcd.virtual.scene.texture import average_cells
from tests.sampled import sampled
from tests.textured import detailed

GRID, FIGURES = (24, 32), (48, 64)
CELL_MEANS = {
    "open-book": (0.02, 0.02), "wax-disk": (0.02, 0.03), "disco-ball": (0.06, 0.30),
    "milky-bottle": (0.03, 0.04), "mirror-and-vase": (0.08, 0.20),
    "still-life": (0.05, 0.20), "ball-wax-book": (0.05, 0.10),
    "chart-in-milk": (0.03, 0.03), "glass-and-balls": (0.03, 0.08),
}  # fmt: skip
"""Most that direct and indirect light in detail may differ from the cells' own, RMS over RMS: light
is linear between cells, which takes the peaks off what is as small as a cell. Those of `STAGED` at
the grid of the figures."""


@cache
def preset(kind: str) -> Scene:
    return build_scene(SceneConfig(kind=kind, grid=FIGURES if kind in STAGED else GRID))


def pixels(height: int, width: int) -> Array:
    """Centres of the pixels of a raster over the field, (height, width, 2)."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return np.stack([x, y], axis=-1)


@pytest.mark.parametrize(
    "kind",
    [
        *sampled(["wax-disk", "disco-ball", "mirror-and-vase", "open-book", "milky-bottle"], 3),
        *(pytest.param(kind, marks=pytest.mark.long) for kind in sorted(STAGED)),
    ],
)
def test_textures_are_true_to_the_cells(kind: str) -> None:
    scene = preset(kind)
    assert scene.textures is not None and scene.split()[1].mean() > 0.03
    places = pixels(384, 512)  # every second pixel
    for texture, cells, limit in zip(scene.textures, scene.split(), CELL_MEANS[kind], strict=True):
        assert texture.shape == (768, 1024, 3) and texture.dtype == np.float64
        assert texture.min() > 0.0 and np.isfinite(texture).all()
        light = average_cells(detailed(cells, scene.grid, texture, places), scene.grid)
        assert np.sqrt(np.mean((light - cells) ** 2) / np.mean(cells**2)) < limit
    # And it holds what cells cannot.
    first = scene.textures[0]
    means = average_cells(first, GRID).reshape(*GRID, 3).repeat(32, axis=0).repeat(32, axis=1)
    assert np.sqrt(np.mean((first - means) ** 2) / np.mean(first**2)) > 0.1


def test_scenes_of_any_grid_share_their_texture() -> None:
    first, other = (
        preset("milky-bottle"),
        build_scene(SceneConfig(kind="milky-bottle", grid=(3, 4))),
    )
    assert first.texture is other.texture and first.indirect_texture is other.indirect_texture
    assert first.texture is not None
    with pytest.raises(ValueError, match="read-only"):
        first.texture[0, 0] = 1.0


@pytest.mark.parametrize("kind", sorted(PRESETS))
def test_no_texture_is_drawn_before_it_is_asked_for(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(shape: tuple[int, int]) -> None:
        raise AssertionError(f"a raster of {shape} was asked for")

    monkeypatch.setattr(detail, "FrameRaster", refuse)
    # A grid and a seed of its own: other tests may have built, and drawn, the usual ones.
    scene = build_scene(SceneConfig(kind=kind, grid=(5, 9), ambient=0.1, options={"seed": 7}))
    scene.white()
    with pytest.raises(AssertionError, match="768, 1024"):
        _ = scene.texture
