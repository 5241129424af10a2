"""An open book: two pages that light each other, with text and a coloured picture."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pdcd.virtual.scene.effects import Array, Effect, make_direct_effects
from pdcd.virtual.scene.presets.canvas import FRAME_WIDTH, Canvas, FrameRaster, Shape, read_seed
from pdcd.virtual.scene.presets.detail import (
    DETAIL,
    TextLine,
    draw_text,
    make_grain,
    make_texture_raster,
    print_ink,
    stretch_columns,
)
from pdcd.virtual.scene.presets.letters import Coverage, measure_text
from pdcd.virtual.scene.radiosity import Relief, make_radiosity_effects
from pdcd.virtual.scene.scene import Scene

_SLOPE = 0.85
"""Rise of either page from the spine outwards: the book is open by some 99 degrees."""
_PAGE_WIDTH = 1.12
_PAPER = (0.84, 0.80, 0.72)
_INK = (0.08, 0.07, 0.07)
CURVE = 0.2
"""How much taller a page looks at a distance of 1 from the spine: its edge is nearer."""
TITLE = "On light that stays"
TITLE_SIZE, SIZE = 0.048, 0.041
"""Heights of a small x in the title and in the text."""
RIGHT, _LEFT, _PITCH = (0.13, 1.06), (-1.00, -0.13), 0.0925
"""Where lines begin and end on either page, and how far they lie apart."""
SENTENCES = (
    "Light falls on this page and does not rest.",
    "Some of it goes straight back to the eye.",
    "The rest will visit the other page first.",
    "Each page is a lamp for its neighbour.",
    "Near the fold they warm each other most.",
    "A red roof leaves a blush on white paper.",
    "Black ink keeps nearly all that it gets.",
    "Lamps are many, but we only see the sum.",
    "What came back twice is soft and has no edge.",
    "The mask decides which of it you may see.",
    "Many patterns make one quiet picture.",
    "Take the first light away and read again.",
)
"""The sentences of the text; `seed` sets their order."""


def open_book(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build an open book in a wooden cradle, seen from above; `seed` sets the order of its text."""
    seed = read_seed("open-book", options)
    canvas = Canvas(grid)
    albedo = canvas.cells(_book(canvas, seed))
    relief = Relief(_SLOPE * np.abs(canvas.cell_x), canvas.pitch)
    direct = albedo * relief.cosine.reshape(-1, 1)
    indirect = make_radiosity_effects("between the pages", relief, albedo, list(np.eye(3)))
    effects: tuple[Effect, ...] = (*make_direct_effects(direct), *indirect)
    return Scene("open-book", grid, effects, texture=partial(_texture, seed))


def _book(raster: FrameRaster, seed: int) -> Array:
    """Draw the book: the reflectance of everything."""
    image = raster.fill((0.20, 0.13, 0.09))
    image += 0.04 * np.sin(9 * raster.y + 2 * np.sin(3 * raster.x[:1]))[..., None]
    image[_spread(raster, _PAGE_WIDTH + 0.10, 0.06)] = (0.36, 0.05, 0.05)
    image[_spread(raster, _PAGE_WIDTH + 0.05, 0.02)] = (0.62, 0.58, 0.50)
    image[_spread(raster, _PAGE_WIDTH, 0.0)] = _PAPER
    print_ink(image, _text(seed), _INK)
    _picture(raster, image)
    image[np.abs(raster.x) < 0.012] *= 0.45
    return image


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw the book in detail, with fibres in its paper and wood."""
    raster = make_texture_raster()
    image = _book(raster, seed)
    wood = ~_spread(raster, _PAGE_WIDTH + 0.10, 0.06)
    image *= make_grain(0.012)[..., None]
    image[wood] *= make_grain(0.08, along=24)[wood][:, None]
    return image


@lru_cache(maxsize=2)
def _text(seed: int) -> Coverage:
    """Write both pages: the share of ink in each pixel of a texture."""
    order = np.random.default_rng(seed).permutation(len(SENTENCES)).tolist()
    lines: list[TextLine] = [(TITLE, RIGHT[0], -0.54, TITLE_SIZE)]
    lines += _column(order, RIGHT, -0.415 + _PITCH * np.arange(12))
    lines += _column(order[::-1], _LEFT, 0.31 + _PITCH * np.arange(4))
    x = (np.arange(DETAIL[1]) + 0.5) * FRAME_WIDTH / DETAIL[1] - FRAME_WIDTH / 2.0
    return stretch_columns(draw_text(lines), 1.0 + CURVE * np.abs(x))


def _column(
    order: Sequence[int], ends: tuple[float, float], places: Iterable[float]
) -> Iterator[TextLine]:
    """Break sentences into lines that end before the right one of `ends`."""
    words = " ".join(SENTENCES[number] for number in order).split()
    for y in places:
        count = 1
        while measure_text(" ".join(words[: count + 1]), SIZE) < ends[1] - ends[0]:
            count += 1
        yield " ".join(words[:count]), ends[0], float(y), SIZE
        del words[:count]


def _spread(raster: FrameRaster, width: float, border: float) -> Shape:
    """Return both pages; their outer edges are nearer to the camera and look taller."""
    far = np.abs(raster.x[:1])  # alike in all rows
    tall = 0.70 + border + 0.14 * far + 0.05 * np.sin(np.pi * np.minimum(far / width, 1.0))
    inside: Shape = (far <= width) & (np.abs(raster.y) <= tall)
    return inside


def _picture(raster: FrameRaster, image: Array) -> None:
    """Draw a framed landscape on the left page: colours that bleed onto the other one."""
    frame = raster.box(-0.98, -0.66, -0.16, 0.14)
    image[frame] = _INK
    inside = raster.box(-0.94, -0.62, -0.20, 0.10)
    image[inside] = (0.35, 0.55, 0.80)
    image[inside & raster.disk(-0.72, -0.38, 0.14)] = (0.88, 0.68, 0.10)
    hills = raster.y > -0.10 + 0.12 * np.sin(6.5 * raster.x)
    image[inside & hills] = (0.15, 0.50, 0.15)
    house = raster.box(-0.44, -0.22, -0.26, 0.00)
    image[inside & house] = (0.80, 0.15, 0.08)
    image[raster.polygon([(-0.48, -0.20), (-0.22, -0.20), (-0.35, -0.36)])] = (0.35, 0.12, 0.08)
