"""A table with everything on it: glass, wax, an open book that stands, a mirror, sweets, glitter.

Each row of the picture crosses most of it, so that a slice of the transport matrix shows the marks
of each: streaks of the glass, a broad band of the wax, a fan of the book, a line of the mirror.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.virtual.scene.effects import Array, Effect, coloured_direct, rgb
from pdcd.virtual.scene.kernel import Kernel, gaussian
from pdcd.virtual.scene.presets import wax
from pdcd.virtual.scene.presets.canvas import Canvas, Raster, Shape, seed_of
from pdcd.virtual.scene.presets.detail import DARKEST, detail, grain, inked, written
from pdcd.virtual.scene.presets.letters import Coverage
from pdcd.virtual.scene.presets.objects import Ball, Rod
from pdcd.virtual.scene.presets.thrown import Thrower, shown_back, thrown, thrown_in_detail
from pdcd.virtual.scene.radiosity import Relief, radiosity
from pdcd.virtual.scene.scene import Scene

TABLE_EDGE = 0.34
ROD = Rod(-1.06, -0.52, 0.52, 0.13, 0.30)
ROD_SHARE = 0.40
DISK = Ball(-0.64, 0.18, 0.30)
"""The wax disk, which stands on its rim."""
WAX = 0.7
"""How far light gets in it, of what it does in the large disk."""
SPINE, PAGE, SLOPE = 0.06, 0.42, 0.95
"""Where the book's pages meet, how wide they look, and how steep they are: open by 93 degrees."""
PAGE_TOP, PAGE_FOOT = -0.62, 0.30
MIRROR_X, MIRROR_HALF = 0.63, 0.09
MIRROR_TOP, MIRROR_FOOT = -0.80, 0.30
MIRROR, MIRROR_LANDS, SQUEEZE = 0.6, 0.92, 1.9
"""Its share of light, where its middle throws it, and how much wider its picture is."""
GLOBE = Ball(1.02, 0.06, 0.29)
SWEETS = 90
SWEET = 0.068
"""Radius of a sweet."""
SWEET_COLOURS = ((0.78, 0.10, 0.10), (0.85, 0.62, 0.08), (0.12, 0.55, 0.18), (0.12, 0.25, 0.70),
           (0.85, 0.36, 0.10), (0.82, 0.80, 0.78))  # fmt: skip
CARD = (-0.325, 0.50, 0.42, 0.90)
"""A card covered with glitter: left, top, right, bottom."""
SQUARE, FLAKE = 0.015, 0.0045
"""Edge of the square in which a flake of glitter lies, and half the edge of the flake."""
GLITTER, SPREAD = 0.6, 1.6
"""Share of its light that a flake throws somewhere, and how much larger it arrives."""
TEXT = (
    ("Light that", -0.325, -0.42), ("stays, two", -0.325, -0.28), ("pages long,", -0.325, -0.14),
    ("is never", -0.325, 0.00), ("seen alone.", -0.325, 0.14),
)  # fmt: skip
SIZE = 0.033
INK, PAPER = (0.08, 0.07, 0.07), (0.80, 0.77, 0.70)
PATCHES = (12, 24)
"""Of the light between pages: a page is half as wide as that of the open book."""


def still_life(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build the table; `seed` sets the heap of sweets and the glitter."""
    seed = seed_of("still-life", options)
    canvas = Canvas(grid)
    matte = canvas.cells(_matte(canvas, seed))
    found = thrown(canvas, _throwers(seed), canvas.cells(_lit(canvas, seed)))
    effects: list[Effect] = [*coloured_direct(canvas.cells(_image(canvas, seed)) + found.back)]
    effects += found.effects
    body = canvas.cells(DISK.on(canvas))
    open_ = body * (1.0 - wax.BLOCKED * canvas.cells(_hidden(canvas)))
    effects += wax.inside(canvas, body, open_, WAX)
    effects += _between_sweets(canvas, seed)
    relief = Relief(_height(canvas.cell_x, canvas.cell_y), canvas.pitch)
    effects += radiosity("between the things", relief, matte, list(np.eye(3)), PATCHES)
    texture, indirect = partial(_texture, seed), partial(_indirect, seed)
    return Scene("still-life", grid, tuple(effects), None, texture, indirect)


def _between_sweets(canvas: Canvas, seed: int) -> Iterator[Kernel]:
    """Light that goes from sweet to sweet, and a little way inside them."""
    colour, _ = _heap(canvas, seed)
    spread = gaussian(canvas.grid, canvas.pitch, 0.05)
    for channel in range(3):
        gate = canvas.cells(np.sqrt(0.4 * colour[..., channel]))
        yield Kernel("sweets", canvas.grid, spread, gate, gate, tint=rgb(*np.eye(3)[channel]))


def _throwers(seed: int) -> tuple[Thrower, ...]:
    return (
        Thrower("glass rod", ROD.caustic, ROD_SHARE),
        Thrower("mirror", _mirrored, MIRROR),
        Thrower("glitter", partial(_glittering, seed), GLITTER),
    )


def _mirrored(x: Array, y: Array) -> tuple[Shape, Array, Array]:
    """Where the mirror throws its light: aside, in the same row."""
    return _mirror(x, y), MIRROR_LANDS - SQUEEZE * (x - MIRROR_X), y


def _mirror(x: Array, y: Array, border: float = 0.0) -> Shape:
    across = (x - MIRROR_X) / MIRROR_HALF
    inside: Shape = np.abs(x - MIRROR_X) < MIRROR_HALF + border
    inside &= y > MIRROR_TOP + 0.03 * across - border
    return inside & (y < MIRROR_FOOT - 0.03 * across + border)


@lru_cache(maxsize=1)
def _flakes(seed: int) -> tuple[Array, Array, Array]:
    """Places (flakes, 2) of the glitter, where each throws its light (flakes, 2), and how much of
    it comes straight back (flakes,); each flake lies in a square of its own of the card."""
    rng = np.random.default_rng([seed, 1])
    down, across = (v.ravel() for v in np.indices(_squares()))
    place = np.stack([across, down], axis=-1) + rng.uniform(0.3, 0.7, (down.size, 2))
    place = np.asarray(CARD[:2]) + SQUARE * place
    # Most flakes lie nearly flat, so that their light lands near.
    to = place + rng.standard_t(3.0, place.shape) * (0.30, 0.22) - (0.0, 0.25)
    return place, to, rng.random(down.size) ** 6


def _squares() -> tuple[int, int]:
    """Rows and columns of the squares in which flakes lie."""
    left, top, right, bottom = CARD
    return round((bottom - top) / SQUARE), round((right - left) / SQUARE)


def _flake_at(seed: int, x: Array, y: Array) -> tuple[NDArray[np.intp], Array]:
    """The flake at each place, -1 for none, and the way (..., 2) from its middle."""
    rows, cols = _squares()
    row = np.floor((y - CARD[1]) / SQUARE).astype(np.intp)
    col = np.floor((x - CARD[0]) / SQUARE).astype(np.intp)
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    number = np.where(inside, row * cols + col, 0)
    off = np.stack([x, y], axis=-1) - _flakes(seed)[0][number]
    there = inside & (np.abs(off) < FLAKE).all(axis=-1)
    return np.where(there, number, -1), off


def _glittering(seed: int, x: Array, y: Array) -> tuple[Shape, Array, Array]:
    """Where flakes throw their light: a copy of each, which gets wider on its way."""
    number, off = _flake_at(seed, x, y)
    to = _flakes(seed)[1][number] + SPREAD * off
    left, top, right, bottom = CARD
    own = (to[..., 0] > left) & (to[..., 0] < right) & (to[..., 1] > top) & (to[..., 1] < bottom)
    return (number >= 0) & ~own, to[..., 0], to[..., 1]


def _matte(raster: Raster, seed: int) -> Array:
    """Draw all that is matte: what light finds that was thrown there."""
    x, y = raster.x, raster.y
    image = raster.fill((0.46, 0.48, 0.47))
    image[y > TABLE_EDGE] = (0.34, 0.22, 0.14)
    _book(raster, image)
    image[_mirror(x, y, 0.025)] = (0.30, 0.20, 0.08)
    image[_mirror(x, y)] = 0.0
    image[DISK.on(raster)] = 0.10
    image[raster.box(0.86, 0.28, 1.18, 0.62)] = (0.55, 0.07, 0.07)
    image[GLOBE.on(raster)] = 0.03
    colour, _ = _heap(raster, seed)
    covered = colour.any(axis=-1)
    image[covered] = 0.5 * colour[covered]
    left, top, right, bottom = CARD
    image[raster.box(left, top, right, bottom)] = (0.10, 0.12, 0.30)
    return image


def _lit(raster: Raster, seed: int) -> Array:
    """Draw what matte things return of light that falls on them."""
    image = _matte(raster, seed)
    image[raster.y > TABLE_EDGE] *= 0.8
    image[_pages(raster)] /= np.hypot(1.0, SLOPE)
    return image


def _image(raster: Raster, seed: int) -> Array:
    """Draw what returns at once."""
    x, y = raster.x, raster.y
    image = _lit(raster, seed)
    disk = DISK.on(raster)
    lean = np.hypot(x - DISK.x, y - DISK.y) / DISK.radius
    image[disk] = (0.19, 0.18, 0.15)
    image[disk & (lean > 0.9)] *= 1.25
    foot = raster.box(0.86, 0.28, 1.18, 0.62)
    image[foot] *= (1.0 - 0.6 * ((x[foot] - GLOBE.x) / 0.2) ** 2)[:, None]
    colour, shine = _heap(raster, seed)
    covered = colour.any(axis=-1)
    image[covered] = 0.65 * colour[covered] + 0.25 * shine[covered][:, None]
    image += 0.15 * GLOBE.glint(raster)[..., None]
    number, _ = _flake_at(seed, x, y)
    flake = number >= 0
    image[flake] = (0.02 + 0.7 * _flakes(seed)[2][number[flake]])[:, None]
    ROD.draw(raster, image)
    return image


def _pages(raster: Raster) -> Shape:
    """Return both pages; their outer edges are nearer and look taller."""
    far = np.abs(raster.x - SPINE) / PAGE
    inside: Shape = (far < 1.0) & (raster.y > PAGE_TOP - 0.06 * far)
    return inside & (raster.y < PAGE_FOOT + 0.10 * far)


def _book(raster: Raster, image: Array) -> None:
    """Draw a book that stands open: text to the left, a picture to the right."""
    x, y = raster.x, raster.y
    far = np.abs(x - SPINE)
    cover = (far < PAGE + 0.03) & (y > PAGE_TOP - 0.11) & (y < PAGE_FOOT + 0.13)
    image[cover] = (0.10, 0.22, 0.16)
    image[_pages(raster)] = PAPER
    inked(image, _text(), INK)
    frame = raster.box(SPINE + 0.07, -0.52, SPINE + 0.33, -0.06)
    image[frame] = (0.75, 0.12, 0.08)
    sun = raster.disk(SPINE + 0.20, -0.32, 0.09)
    image[sun] = (0.85, 0.70, 0.10)
    for line, right in enumerate((0.33, 0.30, 0.32, 0.27, 0.20)):
        top = 0.055 * line
        image[raster.box(SPINE + 0.07, top, SPINE + right, top + 0.02)] = INK
    image[cover & (far < 0.006)] *= 0.5


@lru_cache(maxsize=1)
def _text() -> Coverage:
    return written([(text, x, y, SIZE) for text, x, y in TEXT])


def _hidden(raster: Raster) -> Shape:
    """Return what is inside the wax: a star."""
    turn = np.pi * (np.arange(10) / 5.0 - 0.5)
    far = np.where(np.arange(10) % 2 == 0, 0.20, 0.085)
    corners = zip(DISK.x + far * np.cos(turn), DISK.y + far * np.sin(turn), strict=True)
    return raster.polygon([(float(x), float(y)) for x, y in corners])


@lru_cache(maxsize=1)
def _sweets(seed: int) -> tuple[tuple[Ball, int], ...]:
    """Balls in the globe, those behind first, each with the number of its colour."""
    rng = np.random.default_rng([seed, 2])
    found = []
    for _ in range(SWEETS):
        far, turn = (GLOBE.radius - SWEET) * np.sqrt(rng.random()), rng.uniform(0.0, 2.0 * np.pi)
        x, y = GLOBE.x + far * np.cos(turn), GLOBE.y + far * np.sin(turn)
        if y > GLOBE.y - 0.16:
            found.append((Ball(float(x), float(y), SWEET), int(rng.integers(len(SWEET_COLOURS)))))
    return tuple(found)


def _heap(raster: Raster, seed: int) -> tuple[Array, Array]:
    """Return the colour of the sweets, shaded, (rows, cols, 3), and the glints on them, (rows,
    cols); both 0 where there are none."""
    image, shine = raster.fill((0.0, 0.0, 0.0)), np.zeros(raster.shape)
    for ball, colour in _sweets(seed):
        rows, cols = (
            slice(*np.searchsorted(line, (middle - ball.radius, middle + ball.radius)))
            for line, middle in ((raster.y[:, 0], ball.y), (raster.x[0], ball.x))
        )
        part = raster.part(rows, cols)
        on = ball.on(part)
        image[rows, cols][on] = ball.facing(part)[on][:, None] * np.asarray(SWEET_COLOURS[colour])
        shine[rows, cols][on] = ball.glint(part)[on]
    return image, shine


def _height(x: Array, y: Array) -> Array:
    """Height of the wall, the table and the pages."""
    table = 1.3 * np.maximum(y - TABLE_EDGE, 0.0)
    far = np.abs(x - SPINE)
    pages = np.where((far < PAGE) & (y > PAGE_TOP) & (y < PAGE_FOOT), SLOPE * far, 0.0)
    height: Array = np.maximum(table, pages)
    return height


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw what returns at once in detail."""
    raster = detail()
    image = _image(raster, seed)
    table = raster.y > TABLE_EDGE
    image *= np.where(table, grain(0.08, along=24), grain(0.015))[..., None]
    back = shown_back(_throwers(seed), _lit(raster, seed))
    return np.maximum(image + back, DARKEST)


@lru_cache(maxsize=1)
def _indirect(seed: int) -> Array:
    """Draw the indirect light in detail."""
    raster = detail()
    light = thrown_in_detail(_throwers(seed), _lit(raster, seed)) + 0.10 * _matte(raster, seed)
    open_ = 1.0 - wax.BLOCKED * _hidden(raster)[..., None]
    glow = np.asarray(wax.LIGHT_SHALLOW) + np.asarray(wax.LIGHT_DEEP) * open_
    light += np.where(DISK.on(raster)[..., None], 0.8 * glow, 0.0)
    colour, _ = _heap(raster, seed)
    light += np.sqrt(0.1 * colour) * 0.3
    return np.maximum(light, DARKEST)
