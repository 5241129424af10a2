"""Two balls of styrofoam in a drinking glass: light inside the balls, caustics on the table."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pdcd.virtual.scene.effects import Array, Effect, make_direct_effects, make_tint
from pdcd.virtual.scene.kernel import KernelEffect, make_gaussian_kernel
from pdcd.virtual.scene.presets.canvas import Canvas, FrameRaster, Shape, read_seed
from pdcd.virtual.scene.presets.detail import DARKEST_TEXTURE, make_grain, make_texture_raster
from pdcd.virtual.scene.presets.objects import Ball, Tumbler
from pdcd.virtual.scene.presets.thrown import (
    Thrower,
    draw_returned_light,
    draw_thrown_light,
    make_thrown_paths,
)
from pdcd.virtual.scene.radiosity import Relief, make_radiosity_effects
from pdcd.virtual.scene.scene import Scene

_GLASS = Tumbler(0.0, 0.22, 0.72, 0.86)
_BALLS = (Ball(-0.31, 0.16, 0.29), Ball(0.34, 0.20, 0.25))
_TABLE_EDGE = -0.12
_SPREAD = 0.07
"""How far light gets inside a ball, one standard deviation."""
_GLOW = 0.34
"""Share of the light that comes back out of a ball."""
_ON_BALLS = 0.14
"""Share of the light that the glass throws at a ball and the ball returns at once; much of that
light goes inside."""
_MIRRORED = 0.30
"""Share of its light that the thick far side of the glass throws forwards."""


def styrofoam(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build two styrofoam balls in a glass; `seed` sets their crumbs and the boards."""
    seed = read_seed("glass-and-balls", options)
    canvas = Canvas(grid)
    matte = canvas.cells(_matte(canvas, seed))
    found = make_thrown_paths(canvas, _throwers(), canvas.cells(_lit(canvas, seed)))
    effects: list[Effect] = [*make_direct_effects(canvas.cells(_image(canvas, seed)) + found.back)]
    effects += found.effects
    spread = make_gaussian_kernel(grid, canvas.pitch, _SPREAD)
    for number, ball in enumerate(_BALLS):
        body = canvas.cells(np.sqrt(ball.facing(canvas)))
        tint = _GLOW * make_tint(1.0, 0.98, 0.95)
        effects.append(KernelEffect(f"inside ball {number}", grid, spread, body, body, tint=tint))
    relief = Relief(_height(canvas.cell_x, canvas.cell_y), canvas.pitch)
    effects += make_radiosity_effects("between the things", relief, matte, list(np.eye(3)))
    texture, indirect = partial(_texture, seed), partial(_indirect, seed)
    return Scene("glass-and-balls", grid, tuple(effects), None, texture, indirect)


def _throwers() -> tuple[Thrower, ...]:
    def lands(x: Array, y: Array) -> tuple[Shape, Array, Array]:
        there, to_x, to_y = _GLASS.caustic(x, y)
        for ball in _BALLS:
            there = there & (np.hypot(x - ball.x, y - ball.y) > ball.radius)
        return there, to_x, to_y

    return (Thrower("caustic", lands, _MIRRORED),)


def _matte(raster: FrameRaster, seed: int) -> Array:
    """Draw everything matte, without the glass."""
    rng = np.random.default_rng(seed)
    image = raster.fill((0.30, 0.36, 0.44))
    table = raster.y > _TABLE_EDGE
    shades = rng.uniform(0.85, 1.1, 16)
    fan = 0.55 + 0.5 * (raster.y - _TABLE_EDGE)
    board = np.floor(2.2 * raster.x / fan).astype(int) % 16
    image[table] = np.array((0.36, 0.23, 0.13)) * shades[board[table]][:, None]
    for ball in _BALLS:
        image[ball.on(raster)] = 0.50
    return image


def _lit(raster: FrameRaster, seed: int) -> Array:
    """Draw the share of light that matte things return."""
    image = _matte(raster, seed)
    # The table is lit at a slant, the wall nearly squarely.
    image[raster.y > _TABLE_EDGE] *= 0.8
    for ball in _BALLS:
        image[ball.on(raster)] = _ON_BALLS
    return image


def _image(raster: FrameRaster, seed: int) -> Array:
    """Draw what returns at once."""
    image = _lit(raster, seed)
    far, _ = _GLASS.far_side(raster.x, raster.y)
    image[far] *= 1.0 - _MIRRORED
    for ball in _BALLS:
        on = ball.on(raster)
        image[on] = 0.52 * ball.facing(raster)[on][:, None]
    _GLASS.draw(raster, image)
    return image


def _height(x: Array, y: Array) -> Array:
    """Height of the wall, the table and the balls."""
    height = 1.6 * np.maximum(y - _TABLE_EDGE, 0.0)
    for ball in _BALLS:
        square = ball.radius**2 - (x - ball.x) ** 2 - (y - ball.y) ** 2
        height = height + 0.8 * np.sqrt(np.maximum(square, 0.0))
    return np.asarray(height)


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw what returns at once in detail."""
    raster = make_texture_raster()
    image = _image(raster, seed)
    table, balls = raster.y > _TABLE_EDGE, _balls(raster)
    image *= np.where(table & ~balls, make_grain(0.08, along=24), 1.0)[..., None]
    image[balls] *= _crumbs(seed)[balls][:, None]
    back = draw_returned_light(_throwers(), _lit(raster, seed))
    return np.maximum(image + back, DARKEST_TEXTURE)


@lru_cache(maxsize=1)
def _indirect(seed: int) -> Array:
    """Draw in detail what is lit by the caustic, what the glass shows, and what glows."""
    raster = make_texture_raster()
    light = draw_thrown_light(_throwers(), _lit(raster, seed)) + 0.10 * _matte(raster, seed)
    for ball in _BALLS:
        light += _GLOW * 0.8 * np.sqrt(ball.facing(raster))[..., None]
    return np.maximum(light, DARKEST_TEXTURE)


def _balls(raster: FrameRaster) -> Shape:
    on = np.zeros(raster.shape, dtype=np.bool_)
    for ball in _BALLS:
        on |= ball.on(raster)
    return on


def _crumbs(seed: int) -> Array:
    """Factors of the crumbs of styrofoam: the cells of points thrown at random, `DETAIL`."""
    from scipy.spatial import cKDTree

    raster = make_texture_raster()
    rng = np.random.default_rng(seed)
    points = rng.uniform((-0.7, -0.3), (0.7, 0.6), (5000, 2))
    near, _ = cKDTree(points).query(np.stack([raster.x, raster.y], axis=-1), k=2)
    edge: Array = np.clip((near[..., 1] - near[..., 0]) / 0.008, 0.0, 1.0)
    return 0.80 + 0.28 * edge
