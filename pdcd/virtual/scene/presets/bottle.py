"""A bottle of milky water with a label behind it: a veil hides what direct light still shows."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pdcd.virtual.scene.effects import Array, make_tint
from pdcd.virtual.scene.milk import FORWARD, VEIL, make_milk_effects
from pdcd.virtual.scene.presets.canvas import Canvas, FrameRaster, Shape, read_seed
from pdcd.virtual.scene.presets.detail import (
    DARKEST_TEXTURE,
    draw_text,
    make_grain,
    make_letter_factors,
    make_texture_raster,
)
from pdcd.virtual.scene.scene import Scene

_OPTICAL_DEPTH = 0.75
"""Optical depth of the milk along the bottle's axis."""
_PROFILE_Y = (-0.94, -0.80, -0.79, -0.52, -0.22, -0.10, 0.80, 0.86)
_PROFILE_HALF = (0.15, 0.15, 0.12, 0.13, 0.40, 0.46, 0.46, 0.40)
"""Half width of the bottle at heights from its cap to its foot."""
_MILK_TOP = -0.50
_TABLE = 0.78
"""Where the wall ends."""
_PRINT = (("MILKY WATER", -0.34, 0.100, 0.026), ("shake well, then read", -0.33, 0.640, 0.026))
"""Text on the bands of the label, its place, and the height of a small x."""


def milky_bottle(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build a bottle in front of a tiled wall; `seed` sets the shades of the tiles."""
    seed = read_seed("milky-bottle", options)
    canvas = Canvas(grid)
    effects = make_milk_effects(
        grid,
        canvas.pitch,
        canvas.cells(_depth(canvas)),
        canvas.cells(_behind(canvas, seed)),
        sigma=0.12,
        tint=make_tint(0.95, 0.93, 0.86),
    )
    return Scene(
        "milky-bottle",
        grid,
        effects,
        texture=partial(_texture, seed),
        indirect_texture=partial(_veil, seed),
    )


def _bottle(raster: FrameRaster) -> tuple[Shape, Array]:
    """Return the inside of the glass, and the half width of the bottle at each point's height."""
    half = np.interp(raster.y, _PROFILE_Y, _PROFILE_HALF, left=0.0, right=0.0)
    return (np.abs(raster.x) < half) & ~_cap(raster), half


def _cap(raster: FrameRaster) -> Shape:
    return raster.box(-0.15, -0.94, 0.15, -0.79)


def _behind(raster: FrameRaster, seed: int) -> Array:
    """Draw everything as it is without the milk."""
    image = _wall(raster, np.random.default_rng(seed))
    inside, half = _bottle(raster)
    image[inside] = 0.30
    _label(raster, image)
    image[_cap(raster)] = (0.70, 0.12, 0.10)
    edge = inside & (np.abs(raster.x) > half - 0.03)
    image[edge] *= 0.4
    return image


def _depth(raster: FrameRaster) -> Array:
    """Return the optical depth of the milk in front of each point."""
    inside, half = _bottle(raster)
    filled = inside & (raster.y > _MILK_TOP)
    # A round bottle: the way through the milk is longest on the axis.
    across = np.where(filled, raster.x / np.maximum(half, 1e-9), 1.0)
    depth: Array = _OPTICAL_DEPTH * np.sqrt(np.maximum(1.0 - across**2, 0.0))
    return depth


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw what is seen straight through the milk, in detail."""
    raster = make_texture_raster()
    image = _behind(raster, seed)
    image *= np.exp(-2.0 * _depth(raster))[..., None]
    table = (raster.y > _TABLE) & ~_bottle(raster)[0]
    image *= np.where(table, make_grain(0.10, along=32), make_grain(0.02))[..., None]
    image *= make_letter_factors(draw_text(_PRINT))[..., None]
    return image


@lru_cache(maxsize=1)
def _veil(seed: int) -> Array:
    """Draw what comes back from the milk: an even veil, and what is lit through it."""
    raster = make_texture_raster()
    scattered = (1.0 - np.exp(-2.0 * _depth(raster)))[..., None]
    behind = _behind(raster, seed).mean(axis=-1, keepdims=True)
    # Half of the blurred light is lost on its way back: a mean, good enough for a proportion.
    blurred = 0.5 * np.sqrt(FORWARD * scattered * behind)
    return np.repeat(DARKEST_TEXTURE + VEIL * scattered + blurred, 3, axis=-1)


def _wall(raster: FrameRaster, rng: np.random.Generator) -> Array:
    """Return tiles above a table."""
    image = raster.fill((0.28, 0.42, 0.46))
    tile = 0.4
    shades = rng.uniform(0.8, 1.1, (8, 8))
    row, col = ((place + 2.0) // tile for place in (raster.y, raster.x))
    image *= shades[row.astype(int) % 8, col.astype(int) % 8][..., None]
    joint = ((raster.x + 2.0) % tile < 0.03) | ((raster.y + 2.0) % tile < 0.03)
    image[joint] = (0.55, 0.55, 0.52)
    image[raster.y > _TABLE] = (0.34, 0.22, 0.13)
    return image


def _label(raster: FrameRaster, image: Array) -> None:
    """Draw a label with a bold M between two bands."""
    image[raster.box(-0.38, 0.0, 0.38, 0.70)] = (0.85, 0.85, 0.82)
    for top in (0.05, 0.60):
        image[raster.box(-0.38, top, 0.38, top + 0.06)] = (0.75, 0.10, 0.08)
    letter = raster.polygon(
        [
            (-0.26, 0.54), (-0.26, 0.16), (-0.15, 0.16), (0.00, 0.34), (0.15, 0.16), (0.26, 0.16),
            (0.26, 0.54), (0.15, 0.54), (0.15, 0.34), (0.00, 0.50), (-0.15, 0.34), (-0.15, 0.54),
        ]
    )  # fmt: skip
    image[letter] = (0.05, 0.10, 0.35)
