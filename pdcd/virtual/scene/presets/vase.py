"""A vase beside a mirror: sharp paths between them both ways, over matte inter-reflection."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np
import scipy
from scipy.interpolate import PchipInterpolator

from pdcd.virtual.scene.effects import (
    COLOUR_NAMES,
    Array,
    Effect,
    make_direct_effects,
    make_two_way_paths,
)
from pdcd.virtual.scene.presets.canvas import (
    FRAME_HEIGHT,
    FRAME_WIDTH,
    Canvas,
    FrameRaster,
    Shape,
    read_seed,
)
from pdcd.virtual.scene.presets.detail import DARKEST_TEXTURE, make_grain, make_texture_raster
from pdcd.virtual.scene.radiosity import Relief, make_radiosity_effects
from pdcd.virtual.scene.scene import Scene
from pdcd.virtual.scene.texture import sample_texture

_VASE_X = 0.52
_PROFILE_Y = (-0.72, -0.66, -0.48, -0.05, 0.40, 0.62, 0.70)
_PROFILE_RADIUS = (0.22, 0.19, 0.13, 0.36, 0.30, 0.17, 0.22)
"""Radius of the vase at heights from its lip to its foot."""
_MIRROR_X, _MIRROR_HALF = -0.72, 0.36
"""Middle and half width of the mirror as the camera sees it, slantwise."""
_SQUEEZE = 1.25
"""How much narrower things look in the slanted mirror."""
_MIRROR = 0.80
"""Reflectance of the mirror."""
_GRAZING = 0.4
"""Cosine at which light from the mirror meets what it lights."""
_TABLE_EDGE = 0.50


def mirror_and_vase(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build a painted vase with a mirror to its left; `seed` sets the painting."""
    seed = read_seed("mirror-and-vase", options)
    canvas = Canvas(grid)
    glass = draw_mirror(canvas, 0.0)
    relief = Relief(_height(canvas), canvas.pitch)
    albedo = canvas.cells(_matte(canvas, seed))
    direct = albedo * relief.cosine.reshape(-1, 1)
    shown = canvas.links(glass, _mirrored(canvas), canvas.y)
    reached = _MIRROR * _GRAZING * direct
    # There and back by the mirror: such light returns to its own cell and counts as direct.
    direct = direct + _MIRROR * (shown.T @ reached)
    effects: list[Effect] = [*make_direct_effects(direct)]
    for channel, colour in enumerate(COLOUR_NAMES):
        one_way = scipy.sparse.diags_array(reached[:, channel]) @ shown
        effects.append(make_two_way_paths(f"mirror {colour}", one_way, np.eye(3)[channel]))
    effects.extend(make_radiosity_effects("between the walls", relief, albedo, list(np.eye(3))))
    return Scene("mirror-and-vase", grid, tuple(effects), texture=partial(_texture, seed))


def _matte(raster: FrameRaster, seed: int) -> Array:
    """Draw everything matte; the mirror is not."""
    image = raster.fill((0.66, 0.60, 0.48))
    image[raster.y > _TABLE_EDGE] = (0.40, 0.26, 0.15)
    image[_vase(raster)] = (0.70, 0.70, 0.68)
    _paint(raster, image, np.random.default_rng(seed))
    image[draw_mirror(raster, 0.07)] = (0.45, 0.30, 0.10)
    image[draw_mirror(raster, 0.0)] = 0.0
    return image


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw everything in detail: wallpaper, glaze, gold leaf, and what the mirror shows."""
    raster = make_texture_raster()
    image = _matte(raster, seed)
    glass, vase = draw_mirror(raster, 0.0), _vase(raster)
    frame, table = draw_mirror(raster, 0.07) & ~glass, (raster.y > _TABLE_EDGE) & ~vase
    leaf = np.clip(make_grain(0.5), 0.7, 2.0)
    for shape, factors in (
        (~(glass | vase | frame | table), 1.0 + 0.05 * np.sign(np.sin(300.0 * raster.x))),
        (vase, 1.0 + 0.03 * np.sin(420.0 * raster.y)),
        (table, make_grain(0.12, along=40)),
        (frame, leaf),
    ):
        image[shape] *= factors[shape][:, None]
    place = (
        np.stack([_mirrored(raster)[glass] / FRAME_WIDTH, raster.y[glass] / FRAME_HEIGHT], axis=-1)
        + 0.5
    )
    image[glass] = _MIRROR * _MIRROR * _GRAZING * sample_texture(image, place)
    return np.maximum(image, DARKEST_TEXTURE)


def _mirrored(raster: FrameRaster) -> Array:
    """Return the x of what the mirror shows at each point: things flipped sideways.

    Light goes the same way as sight.
    """
    x: Array = _VASE_X - _SQUEEZE * (raster.x - _MIRROR_X)
    return x


def _vase(raster: FrameRaster) -> Shape:
    shape: Shape = np.abs(raster.x - _VASE_X) < _radius(raster.y)
    return shape


def _radius(y: Array) -> Array:
    """Return the radius of the vase at each height y, 0 above and below it."""
    profile = PchipInterpolator(_PROFILE_Y, _PROFILE_RADIUS, extrapolate=False)
    radius: Array = np.nan_to_num(profile(y))
    return radius


def draw_mirror(raster: FrameRaster, border: float) -> Shape:
    """Return the mirror: it stands on the table, its left edge nearer to the camera."""
    across = (raster.x - _MIRROR_X) / _MIRROR_HALF
    half = 0.70 - 0.07 * across + border
    inside: Shape = np.abs(raster.x - _MIRROR_X) < _MIRROR_HALF + border
    inside &= np.abs(raster.y + 0.03) < half
    return inside


def _paint(raster: FrameRaster, image: Array, rng: np.random.Generator) -> None:
    """Paint bands round the vase, and petals that are turned at random."""
    blue, red = (0.10, 0.18, 0.58), (0.70, 0.16, 0.10)
    radius = _radius(raster.y)
    vase = _vase(raster)
    round_ = np.arcsin(np.clip((raster.x - _VASE_X) / np.maximum(radius, 1e-9), -1.0, 1.0))
    for top, bottom in ((-0.72, -0.64), (-0.42, -0.34), (0.34, 0.42), (0.62, 0.72)):
        image[vase & (raster.y >= top) & (raster.y < bottom)] = blue
    turn = rng.uniform(0.0, 1.0)
    phase = (round_ / 0.7 + turn) % 1.0 - 0.5
    for centre, colour in ((-0.14, red), (0.14, blue)):
        petal = np.hypot(phase / 0.36, (raster.y - centre) / 0.11) < 1.0
        image[vase & petal] = colour


def _height(canvas: Canvas) -> Array:
    """Return the height of wall, table and vase; the mirror counts as part of the wall."""
    table = 1.3 * np.maximum(canvas.cell_y - _TABLE_EDGE, 0.0)
    radius = _radius(canvas.cell_y)
    bulge = radius**2 - (canvas.cell_x - _VASE_X) ** 2
    vase = np.where(bulge > 0, 0.45 + np.sqrt(np.maximum(bulge, 0.0)), 0.0)
    height: Array = np.maximum(table, vase)
    return height
