"""A mirror ball on a disk of wax before an open book: sharp indirect light, and two soft kinds."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pdcd.virtual.scene.effects import Array, Effect, coloured_direct
from pdcd.virtual.scene.presets import wax
from pdcd.virtual.scene.presets.canvas import Canvas, Raster, Shape, seed_of
from pdcd.virtual.scene.presets.detail import DARKEST, detail, grain, inked, written
from pdcd.virtual.scene.presets.letters import Coverage
from pdcd.virtual.scene.presets.mirror_ball import MirrorBall
from pdcd.virtual.scene.presets.thrown import Thrower, shown_back, thrown, thrown_in_detail
from pdcd.virtual.scene.radiosity import Relief, radiosity
from pdcd.virtual.scene.scene import Scene

BALL, RADIUS, RINGS = (0.0, 0.16, 0.60), 0.36, 9
MIRROR = 0.65
"""Reflectance of a facet."""
SLOPE, PAGE = 0.80, 1.14
"""Rise of the pages from the spine outwards, and how wide they look."""
PAGE_TOP, PAGE_FOOT = -0.84, 0.22
TABLE_EDGE, TABLE_RISE = 0.34, 1.2
ROOM = (
    (0.0, SLOPE, 0.0), (0.0, -SLOPE, 0.0), (-TABLE_RISE * TABLE_EDGE, 0.0, TABLE_RISE),
)  # fmt: skip
"""Both pages, whose planes go on as the wall beside them, and the table."""
WAX, WAX_HALF, RIM = (0.0, 0.60), (0.78, 0.27), 0.07
"""Middle of the wax disk, which lies on the table, its half axes, and its thickness."""
WAX_SIZE = 0.7
"""How far light gets in it, of what it does in the large disk."""
INK, PAPER = (0.08, 0.07, 0.07), (0.76, 0.73, 0.67)
SIZE, PITCH = 0.041, 0.12
LEFT = ("Some light comes", "straight back", "to the eye. Some", "sees the other",
        "page first, and", "comes back as a")  # fmt: skip
RIGHT = ("soft glow. A ball", "throws it far, and", "keeps it sharp.", "Wax holds it for",
         "a while, and so", "is never sharp.")  # fmt: skip
"""What stands on either page."""


def ball_wax_book(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build the three; `seed` sets how the ball's facets were glued."""
    seed = seed_of("ball-wax-book", options)
    canvas = Canvas(grid)
    matte = canvas.cells(_matte(canvas))
    lit = canvas.cells(_lit(canvas))
    found = thrown(canvas, [_spots(seed)], lit)
    mirrors = _ball(seed)
    direct = lit.copy()
    facet = mirrors.facet(canvas.x, canvas.y)
    direct += canvas.cells(np.where(facet >= 0, mirrors.facets[1][facet], 0.0))[:, None]
    body = canvas.cells(on_wax(canvas))
    effects: list[Effect] = [*coloured_direct(direct + found.back), *found.effects]
    effects += wax.inside(canvas, body, body, WAX_SIZE)
    relief = Relief(_height(canvas.cell_x, canvas.cell_y), canvas.pitch)
    effects += radiosity("between the pages", relief, matte, list(np.eye(3)))
    texture, indirect = partial(_texture, seed), partial(_indirect, seed)
    return Scene("ball-wax-book", grid, tuple(effects), None, texture, indirect)


def _ball(seed: int) -> MirrorBall:
    return MirrorBall(BALL, RADIUS, RINGS, seed)


def _spots(seed: int) -> Thrower:
    return Thrower("spots", _ball(seed).lands(ROOM), MIRROR, budget=0.28)


def _height(x: Array, y: Array) -> Array:
    """Height of pages and table."""
    planes = [height + right * x + down * y for height, right, down in ROOM]
    height: Array = np.maximum.reduce(planes)
    return height


def on_wax(raster: Raster) -> Shape:
    """Return the wax: its upper side, and its rim towards the camera, but for the ball's foot."""
    across = (raster.x - WAX[0]) / WAX_HALF[0]
    top = np.hypot(across, (raster.y - WAX[1]) / WAX_HALF[1]) < 1.0
    rim = np.hypot(across, (raster.y - WAX[1] - RIM) / WAX_HALF[1]) < 1.0
    rim |= (np.abs(across) < 1.0) & (raster.y > WAX[1]) & (raster.y < WAX[1] + RIM)
    whole: Shape = (top | rim) & ~raster.disk(BALL[0], BALL[1], RADIUS)
    return whole


def on_pages(raster: Raster) -> Shape:
    """Return both pages, also where wax and ball hide them; outer edges are nearer, and taller."""
    far = np.abs(raster.x) / PAGE
    inside: Shape = (far < 1.0) & (raster.y > PAGE_TOP - 0.07 * far)
    return inside & (raster.y < PAGE_FOOT + 0.28 * far)


def _matte(raster: Raster) -> Array:
    """Draw the colours of all but the ball."""
    x, y = raster.x, raster.y
    image = raster.fill((0.26, 0.30, 0.34))
    table = TABLE_RISE * (y - TABLE_EDGE) > SLOPE * np.abs(x)
    image[table] = (0.34, 0.22, 0.14)
    far = np.abs(x) / PAGE
    tall = 0.07 * far
    cover = (far < 1.04) & (y > PAGE_TOP - 0.04 - tall) & (y < PAGE_FOOT + 0.04 + 4.0 * tall)
    image[cover] = (0.45, 0.08, 0.07)
    image[on_pages(raster)] = PAPER
    inked(image, _text(), INK)
    image[cover & (np.abs(x) < 0.008)] *= 0.5
    image[on_wax(raster)] = (0.16, 0.14, 0.10)
    image[raster.disk(BALL[0], BALL[1], RADIUS)] = 0.0
    return image


@lru_cache(maxsize=1)
def _text() -> Coverage:
    lines = [
        (text, x, PAGE_TOP + 0.15 + PITCH * number, SIZE)
        for side, x in ((LEFT, -1.05), (RIGHT, 0.25))
        for number, text in enumerate(side)
    ]
    return written(lines)


def _lit(raster: Raster) -> Array:
    """Draw what all but the ball returns of light that falls on it."""
    image = _matte(raster)
    table = TABLE_RISE * (raster.y - TABLE_EDGE) > SLOPE * np.abs(raster.x)
    on = on_wax(raster)
    image[~table | on] /= np.hypot(1.0, SLOPE)
    image[table] /= np.hypot(1.0, TABLE_RISE)
    top = np.hypot(
        (raster.x - WAX[0]) / WAX_HALF[0], (raster.y - WAX[1]) / WAX_HALF[1]
    ) < 1.0  # fmt: skip
    image[on & ~top] *= 0.7
    return image


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw what returns at once in detail."""
    raster = detail()
    lit = _lit(raster)
    image = lit.copy()
    table = TABLE_RISE * (raster.y - TABLE_EDGE) > SLOPE * np.abs(raster.x)
    image *= np.where(table & ~on_wax(raster), grain(0.10, along=24), grain(0.012))[..., None]
    mirrors = _ball(seed)
    mirrors.draw(raster, image, mirrors.facets[1])
    image += shown_back([_spots(seed)], lit)
    return np.maximum(image, DARKEST)


@lru_cache(maxsize=1)
def _indirect(seed: int) -> Array:
    """Draw the indirect light in detail."""
    raster = detail()
    light = thrown_in_detail([_spots(seed)], _lit(raster)) + 0.15 * _matte(raster)
    glow = 0.8 * (np.asarray(wax.LIGHT_SHALLOW) + np.asarray(wax.LIGHT_DEEP))
    light += np.where(on_wax(raster)[..., None], glow, 0.0)
    return np.maximum(light, DARKEST)
