"""Detail finer than cells: means over cells, values at points, and textures drawn on first use."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from pdcd.virtual.scene.effects import Array, make_direct_effects
from pdcd.virtual.scene.scene import Scene
from pdcd.virtual.scene.texture import average_cells, sample_texture
from tests.textured import detailed

DRAWN: list[int] = []


def draw() -> Array:
    """Draw a texture, and remember that it was drawn."""
    DRAWN.append(1)
    return np.full((2, 2, 3), 0.5)


def centres(height: int, width: int) -> Array:
    """Centres of the pixels of a raster over the field, (height, width, 2)."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return np.stack([x, y], axis=-1)


@pytest.mark.parametrize("grid", [(1, 1), (4, 6), (5, 7), (8, 12), (11, 3), (20, 31)])
def test_means_over_cells_are_those_of_ever_finer_points(grid: tuple[int, int]) -> None:
    texture = np.random.default_rng(1).random((8, 12, 3))
    # Points of a raster that both the pixels and the cells divide: their mean is exact.
    fine = sample_texture(texture, centres(8 * grid[0], 12 * grid[1]))
    wanted = fine.reshape(grid[0], 8, grid[1], 12, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(average_cells(texture, grid), wanted.reshape(-1, 3), rtol=1e-13)


def test_a_point_takes_the_pixel_that_it_lies_in() -> None:
    texture = np.arange(18.0).reshape(2, 3, 3)
    np.testing.assert_array_equal(sample_texture(texture, centres(2, 3)), texture)
    points = np.array([[0.0, 0.0], [0.999, 0.999], [1.0, 1.0], [-2.0, 0.4], [5.0, -1.0]])
    pixels = [(0, 0), (1, 2), (1, 2), (0, 0), (0, 2)]
    np.testing.assert_array_equal(sample_texture(texture, points), [texture[p] for p in pixels])
    np.testing.assert_array_equal(sample_texture(texture, np.full((1, 2), np.nan)), texture[0, :1])


def test_light_that_follows_the_texture_comes_back_as_the_texture() -> None:
    texture = 0.1 + np.random.default_rng(2).random((24, 24, 3))
    cells = 0.7 * average_cells(texture, (6, 8))
    points = centres(24, 24)
    np.testing.assert_allclose(detailed(cells, (6, 8), texture, points), 0.7 * texture, rtol=1e-12)
    # Only proportions count.
    again = detailed(cells, (6, 8), 1000.0 * texture, points)
    np.testing.assert_allclose(again, 0.7 * texture, rtol=1e-12)


def test_a_texture_is_drawn_when_it_is_first_asked_for_and_once() -> None:
    DRAWN.clear()
    effects = make_direct_effects(np.ones((2, 3)))
    scene = Scene("s", (1, 2), effects, texture=draw)
    scene.white(), scene.split()
    assert not DRAWN
    first = scene.texture
    assert first is not None and first is scene.texture
    assert DRAWN == [1]
    assert scene.textures == (first, first)
    # Another process gets the drawing, not what was drawn.
    assert len(pickle.dumps(scene)) < 2000
    there = pickle.loads(pickle.dumps(scene))
    np.testing.assert_array_equal(there.texture, first)
    assert DRAWN == [1, 1]


def test_a_texture_may_be_given_and_indirect_light_have_its_own() -> None:
    image = np.ones((2, 2, 3))
    plain = Scene("s", (1, 2), ())
    assert plain.texture is None and plain.textures is None
    assert Scene("s", (1, 2), (), texture=image).texture is image
    both = Scene("s", (1, 2), (), texture=image, indirect_texture=draw)
    direct, indirect = both.textures or (None, None)
    assert direct is image and indirect is not None and indirect[0, 0, 0] == 0.5
