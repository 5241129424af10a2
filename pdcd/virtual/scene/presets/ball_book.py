"""A mirror ball on wax in front of an open book: sharp indirect light, and two soft kinds."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pdcd.virtual.scene.effects import Array, Effect, make_direct_effects
from pdcd.virtual.scene.presets import wax
from pdcd.virtual.scene.presets.canvas import Canvas, FrameRaster, Shape, read_seed
from pdcd.virtual.scene.presets.detail import (
    DARKEST_TEXTURE,
    draw_text,
    make_grain,
    make_texture_raster,
    print_ink,
)
from pdcd.virtual.scene.presets.letters import Coverage
from pdcd.virtual.scene.presets.mirror_ball import MirrorBall
from pdcd.virtual.scene.presets.thrown import (
    Thrower,
    draw_returned_light,
    draw_thrown_light,
    make_thrown_paths,
)
from pdcd.virtual.scene.radiosity import Relief, make_radiosity_effects
from pdcd.virtual.scene.scene import Scene

_BALL, _RADIUS, _RINGS = (0.0, 0.16, 0.60), 0.36, 9
_MIRROR = 0.65
"""Reflectance of a facet."""
_SLOPE, _PAGE = 0.80, 1.14
"""Rise of the pages from the spine outwards, and how wide they look."""
_PAGE_TOP, _PAGE_FOOT = -0.84, 0.22
_TABLE_EDGE, _TABLE_RISE = 0.34, 1.2
_ROOM = (
    (0.0, _SLOPE, 0.0), (0.0, -_SLOPE, 0.0), (-_TABLE_RISE * _TABLE_EDGE, 0.0, _TABLE_RISE),
)  # fmt: skip
"""Both pages, whose planes go on as the wall beside them, and the table."""
_WAX, _WAX_HALF, _RIM = (0.0, 0.60), (0.78, 0.27), 0.07
"""Middle of the wax disk, which lies on the table, its half axes, and its thickness."""
_WAX_SIZE = 0.7
"""How far light gets in the wax, relative to the large disk."""
_INK, _PAPER = (0.08, 0.07, 0.07), (0.76, 0.73, 0.67)
_SIZE, _PITCH = 0.041, 0.12
_LEFT = ("Some light comes", "straight back", "to the eye. Some", "sees the other",
        "page first, and", "comes back as a")  # fmt: skip
_RIGHT = ("soft glow. A ball", "throws it far, and", "keeps it sharp.", "Wax holds it for",
         "a while, and so", "is never sharp.")  # fmt: skip
"""The text of either page."""


def ball_wax_book(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build ball, wax and book; `seed` sets how the ball's facets were glued."""
    seed = read_seed("ball-wax-book", options)
    canvas = Canvas(grid)
    matte = canvas.cells(_matte(canvas))
    lit = canvas.cells(_lit(canvas))
    found = make_thrown_paths(canvas, [_spots(seed)], lit)
    mirrors = _ball(seed)
    direct = lit.copy()
    facet = mirrors.facet(canvas.x, canvas.y)
    direct += canvas.cells(np.where(facet >= 0, mirrors.facets[1][facet], 0.0))[:, None]
    body = canvas.cells(draw_wax(canvas))
    effects: list[Effect] = [*make_direct_effects(direct + found.back), *found.effects]
    effects += wax.make_wax_kernels(canvas, body, body, _WAX_SIZE)
    relief = Relief(_height(canvas.cell_x, canvas.cell_y), canvas.pitch)
    effects += make_radiosity_effects("between the pages", relief, matte, list(np.eye(3)))
    texture, indirect = partial(_texture, seed), partial(_indirect, seed)
    return Scene("ball-wax-book", grid, tuple(effects), None, texture, indirect)


def _ball(seed: int) -> MirrorBall:
    return MirrorBall(_BALL, _RADIUS, _RINGS, seed)


def _spots(seed: int) -> Thrower:
    return Thrower("spots", _ball(seed).lands(_ROOM), _MIRROR, budget=0.28)


def _height(x: Array, y: Array) -> Array:
    """Height of pages and table."""
    planes = [height + right * x + down * y for height, right, down in _ROOM]
    height: Array = np.maximum.reduce(planes)
    return height


def draw_wax(raster: FrameRaster) -> Shape:
    """Return the wax: its upper side, and its rim towards the camera, but for the ball's foot."""
    across = (raster.x - _WAX[0]) / _WAX_HALF[0]
    top = np.hypot(across, (raster.y - _WAX[1]) / _WAX_HALF[1]) < 1.0
    rim = np.hypot(across, (raster.y - _WAX[1] - _RIM) / _WAX_HALF[1]) < 1.0
    rim |= (np.abs(across) < 1.0) & (raster.y > _WAX[1]) & (raster.y < _WAX[1] + _RIM)
    whole: Shape = (top | rim) & ~raster.disk(_BALL[0], _BALL[1], _RADIUS)
    return whole


def draw_pages(raster: FrameRaster) -> Shape:
    """Return both pages, also where wax and ball hide them; outer edges are nearer, and taller."""
    far = np.abs(raster.x) / _PAGE
    inside: Shape = (far < 1.0) & (raster.y > _PAGE_TOP - 0.07 * far)
    return inside & (raster.y < _PAGE_FOOT + 0.28 * far)


def _matte(raster: FrameRaster) -> Array:
    """Draw the colours of everything but the ball."""
    x, y = raster.x, raster.y
    image = raster.fill((0.26, 0.30, 0.34))
    table = _TABLE_RISE * (y - _TABLE_EDGE) > _SLOPE * np.abs(x)
    image[table] = (0.34, 0.22, 0.14)
    far = np.abs(x) / _PAGE
    tall = 0.07 * far
    cover = (far < 1.04) & (y > _PAGE_TOP - 0.04 - tall) & (y < _PAGE_FOOT + 0.04 + 4.0 * tall)
    image[cover] = (0.45, 0.08, 0.07)
    image[draw_pages(raster)] = _PAPER
    print_ink(image, _text(), _INK)
    image[cover & (np.abs(x) < 0.008)] *= 0.5
    image[draw_wax(raster)] = (0.16, 0.14, 0.10)
    image[raster.disk(_BALL[0], _BALL[1], _RADIUS)] = 0.0
    return image


@lru_cache(maxsize=1)
def _text() -> Coverage:
    lines = [
        (text, x, _PAGE_TOP + 0.15 + _PITCH * number, _SIZE)
        for side, x in ((_LEFT, -1.05), (_RIGHT, 0.25))
        for number, text in enumerate(side)
    ]
    return draw_text(lines)


def _lit(raster: FrameRaster) -> Array:
    """Draw the share of light that everything but the ball returns."""
    image = _matte(raster)
    table = _TABLE_RISE * (raster.y - _TABLE_EDGE) > _SLOPE * np.abs(raster.x)
    on = draw_wax(raster)
    image[~table | on] /= np.hypot(1.0, _SLOPE)
    image[table] /= np.hypot(1.0, _TABLE_RISE)
    top = np.hypot(
        (raster.x - _WAX[0]) / _WAX_HALF[0], (raster.y - _WAX[1]) / _WAX_HALF[1]
    ) < 1.0  # fmt: skip
    image[on & ~top] *= 0.7
    return image


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw what returns at once in detail."""
    raster = make_texture_raster()
    lit = _lit(raster)
    image = lit.copy()
    table = _TABLE_RISE * (raster.y - _TABLE_EDGE) > _SLOPE * np.abs(raster.x)
    image *= np.where(table & ~draw_wax(raster), make_grain(0.10, along=24), make_grain(0.012))[
        ..., None
    ]
    mirrors = _ball(seed)
    mirrors.draw(raster, image, mirrors.facets[1])
    image += draw_returned_light([_spots(seed)], lit)
    return np.maximum(image, DARKEST_TEXTURE)


@lru_cache(maxsize=1)
def _indirect(seed: int) -> Array:
    """Draw the indirect light in detail."""
    raster = make_texture_raster()
    light = draw_thrown_light([_spots(seed)], _lit(raster)) + 0.15 * _matte(raster)
    glow = 0.8 * (np.asarray(wax.LIGHT_SHALLOW) + np.asarray(wax.LIGHT_DEEP))
    light += np.where(draw_wax(raster)[..., None], glow, 0.0)
    return np.maximum(light, DARKEST_TEXTURE)
