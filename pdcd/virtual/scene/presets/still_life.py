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

from pdcd.virtual.scene.effects import Array, Effect, make_direct_effects, make_tint
from pdcd.virtual.scene.kernel import KernelEffect, make_gaussian_kernel
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
from pdcd.virtual.scene.presets.objects import Ball, Rod
from pdcd.virtual.scene.presets.thrown import (
    Thrower,
    draw_returned_light,
    draw_thrown_light,
    make_thrown_paths,
)
from pdcd.virtual.scene.radiosity import Relief, make_radiosity_effects
from pdcd.virtual.scene.scene import Scene

_TABLE_EDGE = 0.34
_ROD = Rod(-1.06, -0.52, 0.52, 0.13, 0.30)
_ROD_SHARE = 0.40
_DISK = Ball(-0.64, 0.18, 0.30)
"""The wax disk, which stands on its rim."""
_WAX = 0.7
"""How far light gets in the wax, relative to the large disk."""
_SPINE, _PAGE, _SLOPE = 0.06, 0.42, 0.95
"""Where the book's pages meet, how wide they look, and how steep they are: open by 93 degrees."""
_PAGE_TOP, _PAGE_FOOT = -0.62, 0.30
MIRROR_X, MIRROR_HALF = 0.63, 0.09
MIRROR_TOP, MIRROR_FOOT = -0.80, 0.30
_MIRROR, MIRROR_LANDS, SQUEEZE = 0.6, 0.92, 1.9
"""The share of light that the mirror reflects, where its middle throws it, and how much wider its
picture is."""
_GLOBE = Ball(1.02, 0.06, 0.29)
_SWEETS = 90
_SWEET = 0.068
"""Radius of a sweet."""
_SWEET_COLOURS = ((0.78, 0.10, 0.10), (0.85, 0.62, 0.08), (0.12, 0.55, 0.18), (0.12, 0.25, 0.70),
           (0.85, 0.36, 0.10), (0.82, 0.80, 0.78))  # fmt: skip
_CARD = (-0.325, 0.50, 0.42, 0.90)
"""A card covered with glitter: left, top, right, bottom."""
_SQUARE, _FLAKE = 0.015, 0.0045
"""Edge of the square in which a flake of glitter lies, and half the edge of the flake."""
_GLITTER, _SPREAD = 0.6, 1.6
"""Share of its light that a flake throws elsewhere, and how much larger its spot is."""
_TEXT = (
    ("Light that", -0.325, -0.42), ("stays, two", -0.325, -0.28), ("pages long,", -0.325, -0.14),
    ("is never", -0.325, 0.00), ("seen alone.", -0.325, 0.14),
)  # fmt: skip
_SIZE = 0.033
_INK, _PAPER = (0.08, 0.07, 0.07), (0.80, 0.77, 0.70)
_PATCHES = (12, 24)
"""Patches for the light between pages: a page is half as wide as that of the open book."""


def still_life(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build the table; `seed` sets the heap of sweets and the glitter."""
    seed = read_seed("still-life", options)
    canvas = Canvas(grid)
    matte = canvas.cells(_matte(canvas, seed))
    found = make_thrown_paths(canvas, _throwers(seed), canvas.cells(_lit(canvas, seed)))
    effects: list[Effect] = [*make_direct_effects(canvas.cells(_image(canvas, seed)) + found.back)]
    effects += found.effects
    body = canvas.cells(_DISK.on(canvas))
    open_ = body * (1.0 - wax.BLOCKED * canvas.cells(_hidden(canvas)))
    effects += wax.make_wax_kernels(canvas, body, open_, _WAX)
    effects += _between_sweets(canvas, seed)
    relief = Relief(_height(canvas.cell_x, canvas.cell_y), canvas.pitch)
    effects += make_radiosity_effects(
        "between the things", relief, matte, list(np.eye(3)), _PATCHES
    )
    texture, indirect = partial(_texture, seed), partial(_indirect, seed)
    return Scene("still-life", grid, tuple(effects), None, texture, indirect)


def _between_sweets(canvas: Canvas, seed: int) -> Iterator[KernelEffect]:
    """Light that goes from sweet to sweet, and a little way inside them."""
    colour, _ = _heap(canvas, seed)
    spread = make_gaussian_kernel(canvas.grid, canvas.pitch, 0.05)
    for channel in range(3):
        gate = canvas.cells(np.sqrt(0.4 * colour[..., channel]))
        yield KernelEffect(
            "sweets", canvas.grid, spread, gate, gate, tint=make_tint(*np.eye(3)[channel])
        )


def _throwers(seed: int) -> tuple[Thrower, ...]:
    return (
        Thrower("glass rod", _ROD.caustic, _ROD_SHARE),
        Thrower("mirror", _mirrored, _MIRROR),
        Thrower("glitter", partial(_glittering, seed), _GLITTER),
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
    place = np.asarray(_CARD[:2]) + _SQUARE * place
    # Most flakes lie nearly flat, so that their light lands near.
    to = place + rng.standard_t(3.0, place.shape) * (0.30, 0.22) - (0.0, 0.25)
    return place, to, rng.random(down.size) ** 6


def _squares() -> tuple[int, int]:
    """Rows and columns of the squares in which flakes lie."""
    left, top, right, bottom = _CARD
    return round((bottom - top) / _SQUARE), round((right - left) / _SQUARE)


def _flake_at(seed: int, x: Array, y: Array) -> tuple[NDArray[np.intp], Array]:
    """The flake at each place, -1 for none, and the way (..., 2) from its middle."""
    rows, cols = _squares()
    row = np.floor((y - _CARD[1]) / _SQUARE).astype(np.intp)
    col = np.floor((x - _CARD[0]) / _SQUARE).astype(np.intp)
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    number = np.where(inside, row * cols + col, 0)
    off = np.stack([x, y], axis=-1) - _flakes(seed)[0][number]
    there = inside & (np.abs(off) < _FLAKE).all(axis=-1)
    return np.where(there, number, -1), off


def _glittering(seed: int, x: Array, y: Array) -> tuple[Shape, Array, Array]:
    """Where flakes throw their light: a copy of each, which gets wider on its way."""
    number, off = _flake_at(seed, x, y)
    to = _flakes(seed)[1][number] + _SPREAD * off
    left, top, right, bottom = _CARD
    own = (to[..., 0] > left) & (to[..., 0] < right) & (to[..., 1] > top) & (to[..., 1] < bottom)
    return (number >= 0) & ~own, to[..., 0], to[..., 1]


def _matte(raster: FrameRaster, seed: int) -> Array:
    """Draw everything matte: what thrown light falls on."""
    x, y = raster.x, raster.y
    image = raster.fill((0.46, 0.48, 0.47))
    image[y > _TABLE_EDGE] = (0.34, 0.22, 0.14)
    _book(raster, image)
    image[_mirror(x, y, 0.025)] = (0.30, 0.20, 0.08)
    image[_mirror(x, y)] = 0.0
    image[_DISK.on(raster)] = 0.10
    image[raster.box(0.86, 0.28, 1.18, 0.62)] = (0.55, 0.07, 0.07)
    image[_GLOBE.on(raster)] = 0.03
    colour, _ = _heap(raster, seed)
    covered = colour.any(axis=-1)
    image[covered] = 0.5 * colour[covered]
    left, top, right, bottom = _CARD
    image[raster.box(left, top, right, bottom)] = (0.10, 0.12, 0.30)
    return image


def _lit(raster: FrameRaster, seed: int) -> Array:
    """Draw the share of light that matte things return."""
    image = _matte(raster, seed)
    image[raster.y > _TABLE_EDGE] *= 0.8
    image[_pages(raster)] /= np.hypot(1.0, _SLOPE)
    return image


def _image(raster: FrameRaster, seed: int) -> Array:
    """Draw what returns at once."""
    x, y = raster.x, raster.y
    image = _lit(raster, seed)
    disk = _DISK.on(raster)
    lean = np.hypot(x - _DISK.x, y - _DISK.y) / _DISK.radius
    image[disk] = (0.19, 0.18, 0.15)
    image[disk & (lean > 0.9)] *= 1.25
    foot = raster.box(0.86, 0.28, 1.18, 0.62)
    image[foot] *= (1.0 - 0.6 * ((x[foot] - _GLOBE.x) / 0.2) ** 2)[:, None]
    colour, shine = _heap(raster, seed)
    covered = colour.any(axis=-1)
    image[covered] = 0.65 * colour[covered] + 0.25 * shine[covered][:, None]
    image += 0.15 * _GLOBE.glint(raster)[..., None]
    number, _ = _flake_at(seed, x, y)
    flake = number >= 0
    image[flake] = (0.02 + 0.7 * _flakes(seed)[2][number[flake]])[:, None]
    _ROD.draw(raster, image)
    return image


def _pages(raster: FrameRaster) -> Shape:
    """Return both pages; their outer edges are nearer and look taller."""
    far = np.abs(raster.x - _SPINE) / _PAGE
    inside: Shape = (far < 1.0) & (raster.y > _PAGE_TOP - 0.06 * far)
    return inside & (raster.y < _PAGE_FOOT + 0.10 * far)


def _book(raster: FrameRaster, image: Array) -> None:
    """Draw a book that stands open: text to the left, a picture to the right."""
    x, y = raster.x, raster.y
    far = np.abs(x - _SPINE)
    cover = (far < _PAGE + 0.03) & (y > _PAGE_TOP - 0.11) & (y < _PAGE_FOOT + 0.13)
    image[cover] = (0.10, 0.22, 0.16)
    image[_pages(raster)] = _PAPER
    print_ink(image, _text(), _INK)
    frame = raster.box(_SPINE + 0.07, -0.52, _SPINE + 0.33, -0.06)
    image[frame] = (0.75, 0.12, 0.08)
    sun = raster.disk(_SPINE + 0.20, -0.32, 0.09)
    image[sun] = (0.85, 0.70, 0.10)
    for line, right in enumerate((0.33, 0.30, 0.32, 0.27, 0.20)):
        top = 0.055 * line
        image[raster.box(_SPINE + 0.07, top, _SPINE + right, top + 0.02)] = _INK
    image[cover & (far < 0.006)] *= 0.5


@lru_cache(maxsize=1)
def _text() -> Coverage:
    return draw_text([(text, x, y, _SIZE) for text, x, y in _TEXT])


def _hidden(raster: FrameRaster) -> Shape:
    """Return what is inside the wax: a star."""
    turn = np.pi * (np.arange(10) / 5.0 - 0.5)
    far = np.where(np.arange(10) % 2 == 0, 0.20, 0.085)
    corners = zip(_DISK.x + far * np.cos(turn), _DISK.y + far * np.sin(turn), strict=True)
    return raster.polygon([(float(x), float(y)) for x, y in corners])


@lru_cache(maxsize=1)
def _sweets(seed: int) -> tuple[tuple[Ball, int], ...]:
    """Balls in the globe, those behind first, each with the number of its colour."""
    rng = np.random.default_rng([seed, 2])
    found = []
    for _ in range(_SWEETS):
        far, turn = (_GLOBE.radius - _SWEET) * np.sqrt(rng.random()), rng.uniform(0.0, 2.0 * np.pi)
        x, y = _GLOBE.x + far * np.cos(turn), _GLOBE.y + far * np.sin(turn)
        if y > _GLOBE.y - 0.16:
            found.append((Ball(float(x), float(y), _SWEET), int(rng.integers(len(_SWEET_COLOURS)))))
    return tuple(found)


def _heap(raster: FrameRaster, seed: int) -> tuple[Array, Array]:
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
        image[rows, cols][on] = ball.facing(part)[on][:, None] * np.asarray(_SWEET_COLOURS[colour])
        shine[rows, cols][on] = ball.glint(part)[on]
    return image, shine


def _height(x: Array, y: Array) -> Array:
    """Height of the wall, the table and the pages."""
    table = 1.3 * np.maximum(y - _TABLE_EDGE, 0.0)
    far = np.abs(x - _SPINE)
    pages = np.where((far < _PAGE) & (y > _PAGE_TOP) & (y < _PAGE_FOOT), _SLOPE * far, 0.0)
    height: Array = np.maximum(table, pages)
    return height


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw what returns at once in detail."""
    raster = make_texture_raster()
    image = _image(raster, seed)
    table = raster.y > _TABLE_EDGE
    image *= np.where(table, make_grain(0.08, along=24), make_grain(0.015))[..., None]
    back = draw_returned_light(_throwers(seed), _lit(raster, seed))
    return np.maximum(image + back, DARKEST_TEXTURE)


@lru_cache(maxsize=1)
def _indirect(seed: int) -> Array:
    """Draw the indirect light in detail."""
    raster = make_texture_raster()
    light = draw_thrown_light(_throwers(seed), _lit(raster, seed)) + 0.10 * _matte(raster, seed)
    open_ = 1.0 - wax.BLOCKED * _hidden(raster)[..., None]
    glow = np.asarray(wax.LIGHT_SHALLOW) + np.asarray(wax.LIGHT_DEEP) * open_
    light += np.where(_DISK.on(raster)[..., None], 0.8 * glow, 0.0)
    colour, _ = _heap(raster, seed)
    light += np.sqrt(0.1 * colour) * 0.3
    return np.maximum(light, DARKEST_TEXTURE)
