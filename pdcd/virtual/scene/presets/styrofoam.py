"""Two balls of styrofoam in a drinking glass: light inside the balls, caustics on the table."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pdcd.virtual.scene.effects import Array, Effect, coloured_direct, rgb
from pdcd.virtual.scene.kernel import Kernel, gaussian
from pdcd.virtual.scene.presets.canvas import Canvas, Raster, Shape, seed_of
from pdcd.virtual.scene.presets.detail import DARKEST, detail, grain
from pdcd.virtual.scene.presets.objects import Ball, Tumbler
from pdcd.virtual.scene.presets.thrown import Thrower, shown_back, thrown, thrown_in_detail
from pdcd.virtual.scene.radiosity import Relief, radiosity
from pdcd.virtual.scene.scene import Scene

GLASS = Tumbler(0.0, 0.22, 0.72, 0.86)
BALLS = (Ball(-0.31, 0.16, 0.29), Ball(0.34, 0.20, 0.25))
TABLE_EDGE = -0.12
SPREAD = 0.07
"""How far light gets inside a ball, one standard deviation."""
GLOW = 0.34
"""What comes back out of a ball."""
ON_BALLS = 0.14
"""What balls return at once of light that the glass throws at them; much of it goes inside."""
MIRRORED = 0.30
"""Share of its light that the thick far side of the glass throws forwards."""


def styrofoam(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build two styrofoam balls in a glass; `seed` sets their crumbs and the boards."""
    seed = seed_of("glass-and-balls", options)
    canvas = Canvas(grid)
    matte = canvas.cells(_matte(canvas, seed))
    found = thrown(canvas, _throwers(), canvas.cells(_lit(canvas, seed)))
    effects: list[Effect] = [*coloured_direct(canvas.cells(_image(canvas, seed)) + found.back)]
    effects += found.effects
    spread = gaussian(grid, canvas.pitch, SPREAD)
    for number, ball in enumerate(BALLS):
        body = canvas.cells(np.sqrt(ball.facing(canvas)))
        tint = GLOW * rgb(1.0, 0.98, 0.95)
        effects.append(Kernel(f"inside ball {number}", grid, spread, body, body, tint=tint))
    relief = Relief(_height(canvas.cell_x, canvas.cell_y), canvas.pitch)
    effects += radiosity("between the things", relief, matte, list(np.eye(3)))
    texture, indirect = partial(_texture, seed), partial(_indirect, seed)
    return Scene("glass-and-balls", grid, tuple(effects), None, texture, indirect)


def _throwers() -> tuple[Thrower, ...]:
    def lands(x: Array, y: Array) -> tuple[Shape, Array, Array]:
        there, to_x, to_y = GLASS.caustic(x, y)
        for ball in BALLS:
            there = there & (np.hypot(x - ball.x, y - ball.y) > ball.radius)
        return there, to_x, to_y

    return (Thrower("caustic", lands, MIRRORED),)


def _matte(raster: Raster, seed: int) -> Array:
    """Draw all that is matte, without the glass."""
    rng = np.random.default_rng(seed)
    image = raster.fill((0.30, 0.36, 0.44))
    table = raster.y > TABLE_EDGE
    shades = rng.uniform(0.85, 1.1, 16)
    fan = 0.55 + 0.5 * (raster.y - TABLE_EDGE)
    board = np.floor(2.2 * raster.x / fan).astype(int) % 16
    image[table] = np.array((0.36, 0.23, 0.13)) * shades[board[table]][:, None]
    for ball in BALLS:
        image[ball.on(raster)] = 0.50
    return image


def _lit(raster: Raster, seed: int) -> Array:
    """Draw what matte things return of light that falls on them."""
    image = _matte(raster, seed)
    # A table is lit aslant, a wall nearly squarely.
    image[raster.y > TABLE_EDGE] *= 0.8
    for ball in BALLS:
        image[ball.on(raster)] = ON_BALLS
    return image


def _image(raster: Raster, seed: int) -> Array:
    """Draw what returns at once."""
    image = _lit(raster, seed)
    far, _ = GLASS.far_side(raster.x, raster.y)
    image[far] *= 1.0 - MIRRORED
    for ball in BALLS:
        on = ball.on(raster)
        image[on] = 0.52 * ball.facing(raster)[on][:, None]
    GLASS.draw(raster, image)
    return image


def _height(x: Array, y: Array) -> Array:
    """Height of the wall, the table and the balls."""
    height = 1.6 * np.maximum(y - TABLE_EDGE, 0.0)
    for ball in BALLS:
        square = ball.radius**2 - (x - ball.x) ** 2 - (y - ball.y) ** 2
        height = height + 0.8 * np.sqrt(np.maximum(square, 0.0))
    return np.asarray(height)


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw what returns at once in detail."""
    raster = detail()
    image = _image(raster, seed)
    table, balls = raster.y > TABLE_EDGE, _balls(raster)
    image *= np.where(table & ~balls, grain(0.08, along=24), 1.0)[..., None]
    image[balls] *= _crumbs(seed)[balls][:, None]
    back = shown_back(_throwers(), _lit(raster, seed))
    return np.maximum(image + back, DARKEST)


@lru_cache(maxsize=1)
def _indirect(seed: int) -> Array:
    """Draw in detail what is lit by the caustic, what the glass shows, and what glows."""
    raster = detail()
    light = thrown_in_detail(_throwers(), _lit(raster, seed)) + 0.10 * _matte(raster, seed)
    for ball in BALLS:
        light += GLOW * 0.8 * np.sqrt(ball.facing(raster))[..., None]
    return np.maximum(light, DARKEST)


def _balls(raster: Raster) -> Shape:
    on = np.zeros(raster.shape, dtype=np.bool_)
    for ball in BALLS:
        on |= ball.on(raster)
    return on


def _crumbs(seed: int) -> Array:
    """Factors of the crumbs of styrofoam: the cells of points thrown at random, `DETAIL`."""
    from scipy.spatial import cKDTree

    raster = detail()
    rng = np.random.default_rng(seed)
    points = rng.uniform((-0.7, -0.3), (0.7, 0.6), (5000, 2))
    near, _ = cKDTree(points).query(np.stack([raster.x, raster.y], axis=-1), k=2)
    edge: Array = np.clip((near[..., 1] - near[..., 0]) / 0.008, 0.0, 1.0)
    return 0.80 + 0.28 * edge
