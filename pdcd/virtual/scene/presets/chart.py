"""A resolution chart on the back of a tank of milky water: a floodlit photo shows hardly any of it.

Milk sends light back in two ways. Most wanders all through the tank and comes back as a veil. Some
turns round soon and comes back close to where it went in. That light has no edges finer than a few
cells, so it adds the same to a cell and to the next one, and their difference is free of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pdcd.virtual.scene.effects import Array, Effect, make_tint
from pdcd.virtual.scene.kernel import KernelEffect, make_gaussian_kernel
from pdcd.virtual.scene.milk import make_milk_effects
from pdcd.virtual.scene.presets.canvas import Canvas, FrameRaster, Shape, read_seed
from pdcd.virtual.scene.presets.detail import (
    DARKEST_TEXTURE,
    draw_text,
    make_grain,
    make_texture_raster,
    print_ink,
)
from pdcd.virtual.scene.scene import Scene

_TANK = (-1.12, -0.74, 1.12, 0.72)
"""Left, top, right, bottom of the milk."""
_OPTICAL_DEPTH = 1.15
_VEIL, _FORWARD = 0.50, 0.08
"""Shares of the scattered light: see `pdcd.virtual.scene.milk`."""
_BACK, _NEAR = 0.16, 0.17
"""Share of the scattered light that turns round soon, and how far it gets (one standard
deviation)."""
_BLUR = 0.10
_PAPER, _INK = (0.86, 0.86, 0.84), (0.05, 0.05, 0.05)
BLOCKS = (
    (-1.02, -0.64, 0.078), (0.06, -0.64, 0.056), (0.06, -0.25, 0.040), (0.62, -0.25, 0.029),
    (0.06, 0.04, 0.021), (0.40, 0.04, 0.015),
)  # fmt: skip
"""Left, top, and width of a bar, of blocks of three upright and three level bars."""
_STAR = (-0.56, 0.26, 0.37, 18)
"""Middle, radius and rays of a star."""
_WORDS = (("three bars", 0.06, 0.38, 0.044), ("to a block", 0.06, 0.54, 0.044))


def chart_in_milk(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build the tank; `seed` sets the shades of the boards it stands on."""
    seed = read_seed("chart-in-milk", options)
    canvas = Canvas(grid)
    depth, behind = canvas.cells(_depth(canvas)), canvas.cells(_behind(canvas, seed))
    tint = make_tint(0.97, 0.95, 0.90)
    effects: list[Effect] = list(
        make_milk_effects(
            grid, canvas.pitch, depth, behind,
            sigma=_BLUR, tint=tint, veil=_VEIL, forward=_FORWARD,
        )
    )  # fmt: skip
    gate = np.sqrt(_BACK * _scattered(depth))
    near = make_gaussian_kernel(grid, canvas.pitch, _NEAR)
    effects.append(KernelEffect("back soon", grid, near, gate, gate, tint=tint))
    texture, indirect = partial(_texture, seed), partial(_veil, seed)
    return Scene("chart-in-milk", grid, tuple(effects), None, texture, indirect)


@lru_cache(maxsize=1)
def list_chart_bars() -> list[tuple[Shape, Shape]]:
    """Return the upright bars of each block and the gaps between them, in pixels of a texture:
    where the contrast of the chart is measured. The widest come first. The lists are kept: copy
    them before you change them."""
    raster = make_texture_raster()
    found = []
    for left, top, wide in BLOCKS:
        ink = np.zeros(raster.shape, dtype=np.bool_)
        gap = np.zeros(raster.shape, dtype=np.bool_)
        for number in range(5):
            start = left + number * wide
            # The middle of a bar: pixels at its edges are part bar, part gap.
            bar = raster.box(start + 0.25 * wide, top + wide, start + 0.75 * wide, top + 4.0 * wide)
            if number % 2:
                gap |= bar
            else:
                ink |= bar
        found.append((ink, gap))
    return found


def _scattered(depth: Array) -> Array:
    """Share of the light that is scattered on its way through the milk, there and back."""
    share: Array = 1.0 - np.exp(-2.0 * depth)
    return share


def _tank(raster: FrameRaster) -> Shape:
    return raster.box(*_TANK)


def _depth(raster: FrameRaster) -> Array:
    return np.where(_tank(raster), _OPTICAL_DEPTH, 0.0)


def _behind(raster: FrameRaster, seed: int) -> Array:
    """Draw everything as it is without the milk: a tank with the chart on its back."""
    image = raster.fill((0.22, 0.26, 0.33))
    table = raster.y > 0.62
    shades = np.random.default_rng(seed).uniform(0.8, 1.1, 12)
    board = np.floor((raster.x + 4.0) / np.maximum(0.25 + 0.4 * raster.y, 0.2)).astype(int) % 12
    image[table] = np.array((0.40, 0.26, 0.15)) * shades[board[table]][:, None]
    left, top, right, bottom = _TANK
    image[raster.box(left - 0.04, top - 0.14, right + 0.04, bottom + 0.04)] = (0.30, 0.38, 0.38)
    image[raster.box(left, top - 0.14, right, top)] = (0.27, 0.33, 0.36)
    inside = _tank(raster)
    image[inside] = _PAPER
    image[_ink(raster) & inside] = _INK
    print_ink(image, draw_text(_WORDS), _INK)
    edge = np.abs(np.abs(raster.x) - right - 0.02) < 0.008
    image[edge & (raster.y > top - 0.14) & (raster.y < bottom + 0.04)] = (0.62, 0.70, 0.68)
    return image


def _ink(raster: FrameRaster) -> Shape:
    """Return blocks of bars and the star."""
    x, y = raster.x, raster.y
    ink = np.zeros(raster.shape, dtype=np.bool_)
    for left, top, wide in BLOCKS:
        for number in range(0, 5, 2):
            start = number * wide
            ink |= raster.box(left + start, top, left + start + wide, top + 5.0 * wide)
            across = left + 6.5 * wide
            ink |= raster.box(across, top + start, across + 5.0 * wide, top + start + wide)
    middle_x, middle_y, radius, rays = _STAR
    turn = np.arctan2(y - middle_y, x - middle_x)
    star = (np.sin(rays * turn) > 0.0) & (np.hypot(x - middle_x, y - middle_y) < radius)
    whole: Shape = ink | star
    return whole


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw what is seen straight through the milk, in detail."""
    raster = make_texture_raster()
    image = _behind(raster, seed) * np.exp(-2.0 * _depth(raster))[..., None]
    table = (raster.y > 0.76) & ~_tank(raster)
    image *= np.where(table, make_grain(0.08, along=32), make_grain(0.01))[..., None]
    return np.maximum(image, DARKEST_TEXTURE)


@lru_cache(maxsize=1)
def _veil(seed: int) -> Array:
    """Draw what comes back from the milk, and from the chart that it lights."""
    raster = make_texture_raster()
    scattered = _scattered(_depth(raster))[..., None]
    behind = _behind(raster, seed).mean(axis=-1, keepdims=True)
    light = (_VEIL + _BACK) * scattered + np.sqrt(_FORWARD * scattered * behind) * np.sqrt(
        _FORWARD * scattered * 0.6
    )
    return np.repeat(np.maximum(light, DARKEST_TEXTURE), 3, axis=-1)
