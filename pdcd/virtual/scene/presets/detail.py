"""What presets draw their textures with: a raster of projector pixels, text, grain."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.presets import letters
from pdcd.virtual.scene.presets.canvas import FRAME_HEIGHT, FRAME_WIDTH, FrameRaster
from pdcd.virtual.scene.texture import average_cells

DETAIL = (768, 1024)
"""Rows and columns of a texture: pixels of a projector, whatever the grid."""
TEXTURE_PIXELS = DETAIL[0] / FRAME_HEIGHT
"""Pixels of a texture in one unit of the frame, along either axis."""
DARKEST_TEXTURE = 0.004
"""Least value of a texture, which is divided by its means over cells."""

_AROUND, _STRENGTH = 17, 1.3
"""Pixels, about a cell, over which the ground is darkened to balance bright letters; and their
contrast."""

TextLine = tuple[str, float, float, float]
"""A text, the x of its left end, the y of its base line, and the height of its small letters."""


def make_texture_raster() -> FrameRaster:
    """Return the raster of a texture."""
    return FrameRaster(DETAIL)


def draw_text(lines: Iterable[TextLine]) -> letters.Coverage:
    """Return the share of ink in each pixel of a texture, `DETAIL`. Text must lie in the frame."""
    page = np.zeros(DETAIL, dtype=np.float32)
    for text, x, y, size in lines:
        line = letters.draw_text_line(text, size * TEXTURE_PIXELS)
        left = round((x + FRAME_WIDTH / 2.0) * TEXTURE_PIXELS)
        top = round((y + FRAME_HEIGHT / 2.0 - letters.TOP * size) * TEXTURE_PIXELS)
        there = page[top : top + line.shape[0], left : left + line.shape[1]]
        np.maximum(there, line, out=there)
    return page


def stretch_columns(page: letters.Coverage, stretch: Array) -> letters.Coverage:
    """Return a page whose columns are each stretched up and down from the middle, by `stretch`."""
    rows, cols = page.shape
    middle = (rows - 1) / 2.0
    source = np.clip((np.arange(rows)[:, None] - middle) / stretch + middle, 0.0, rows - 1.001)
    above = source.astype(np.intp)
    share = (source - above).astype(np.float32)
    column = np.arange(cols)
    tall: letters.Coverage = page[above, column] * (1.0 - share) + page[above + 1, column] * share
    return tall


def print_ink(image: Array, ink: NDArray[np.float32], colour: Sequence[float]) -> None:
    """Print on an image (rows, cols, 3) of any raster, in place; `ink` is of `DETAIL`."""
    share = ink[..., None].astype(np.float64)
    if image.shape[:2] != ink.shape:
        share = average_cells(share, (image.shape[0], image.shape[1])).reshape(*image.shape[:2], 1)
    image += share * (np.asarray(colour) - image)


def make_letter_factors(page: letters.Coverage) -> Array:
    """Return factors, `DETAIL`, that show a page but leave the means of cells unchanged: letters
    are brighter than their ground, and the ground around them is darker."""
    near = scipy.ndimage.uniform_filter(page.astype(np.float64), _AROUND)
    factors: Array = 1.0 + _STRENGTH * (page - near)
    return factors


def make_grain(strength: float, along: int = 1) -> Array:
    """Return factors about 1, `DETAIL`, that scatter by `strength`: fibres, plaster, wood.

    along : how many pixels of a row are alike.
    """
    rng = np.random.default_rng(1)
    short = rng.standard_normal((DETAIL[0], DETAIL[1] // along + 1), dtype=np.float32)
    factors: Array = 1.0 + strength * np.clip(short, -2.5, 2.5).astype(np.float64)
    return factors.repeat(along, axis=1)[:, : DETAIL[1]]


def draw_scratches(rng: np.random.Generator, count: int, radius: float) -> Array:
    """Return hairline scratches over a disk about the middle of the frame, `DETAIL`, 0 to 1."""
    image = np.zeros(DETAIL)
    steps = np.linspace(0.0, 1.0, 400)
    for _ in range(count):
        away, around, turn = radius * np.sqrt(rng.random()), *rng.uniform(0.0, 2.0 * np.pi, 2)
        length, bend, depth = rng.exponential(0.18), rng.normal(0.0, 0.4), rng.uniform(0.3, 1.0)
        way = turn + bend * steps
        step = min(length, 0.9) / steps.size * TEXTURE_PIXELS
        across = (away * np.cos(around) + FRAME_WIDTH / 2.0) * TEXTURE_PIXELS + step * np.cumsum(
            np.cos(way)
        )
        down = (away * np.sin(around) + FRAME_HEIGHT / 2.0) * TEXTURE_PIXELS + step * np.cumsum(
            np.sin(way)
        )
        left, top = np.floor(across - 0.5), np.floor(down - 0.5)
        for x, y in ((0, 0), (1, 0), (0, 1), (1, 1)):  # shared by the four pixels around
            near = (1.0 - np.abs(across - 0.5 - left - x)) * (1.0 - np.abs(down - 0.5 - top - y))
            row, column = (top + y).astype(np.intp), (left + x).astype(np.intp)
            seen = (row >= 0) & (row < DETAIL[0]) & (column >= 0) & (column < DETAIL[1])
            place = (row[seen], column[seen])
            np.maximum.at(image, place, depth * near[seen])
    return image
