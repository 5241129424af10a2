"""Letters of our own stroke font, and lines of text as images.

A letter is a few strokes of a broad pen, which makes upright parts thick and level parts thin.
Strokes are polylines; bows are parts of ellipses. The unit is the height of a small x: 0 is the
base line, 1 the top of an x; y points up.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

_Point = tuple[float, float]
_Stroke = Sequence[_Point]
Coverage = NDArray[np.float32]
"""Share of each pixel that is ink, (rows, cols)."""

_PEN = (0.165, 0.10)
"""Half width of upright and of level strokes."""
TOP, _BOTTOM = 1.75, -0.65
"""Top of the tallest and bottom of the deepest letter, pen included."""
_SPACE = 0.5
"""Width of a space."""
_GAP = 0.22
"""Gap between two letters, on top of their pens' widths."""


def _bow(x: float, y: float, across: float, up: float, start: float, stop: float) -> list[_Point]:
    """Part of an ellipse about (x, y), from `start` to `stop` degrees, counter-clockwise from the
    right."""
    steps = max(2, round(abs(stop - start) / 20.0))
    turns = [math.radians(start + (stop - start) * k / steps) for k in range(steps + 1)]
    return [(x + across * math.cos(turn), y + up * math.sin(turn)) for turn in turns]


def _ring(x: float, width: float) -> list[_Point]:
    """A small round letter of this width, its left end at x."""
    return _bow(x + width / 2, 0.5, width / 2, 0.5, 0, 360)


_O = _ring(0.0, 0.8)
_SHOULDER = [*_bow(0.36, 0.62, 0.34, 0.38, 150, 0), (0.70, 0.0)]
_CUP = [(0.0, 1.0), *_bow(0.34, 0.36, 0.34, 0.36, 180, 330)]
_STEM: list[_Point] = [(0.0, 0.0), (0.0, 1.0)]
_TALL: list[_Point] = [(0.0, 0.0), (0.0, 1.6)]

STROKES: dict[str, tuple[_Stroke, ...]] = {
    "a": (
        [*_bow(0.34, 0.68, 0.32, 0.32, 150, 0), (0.66, 0.0)],
        _bow(0.34, 0.29, 0.34, 0.29, 20, 340),
    ),
    "b": (_TALL, _O),
    "c": (_bow(0.4, 0.5, 0.4, 0.5, 45, 315),),
    "d": (_O, [(0.8, 0.0), (0.8, 1.6)]),
    "e": ([(0.03, 0.54), (0.77, 0.54), *_bow(0.4, 0.5, 0.38, 0.5, 10, 310)],),
    "f": ([(0.2, 0.0), *_bow(0.5, 1.28, 0.3, 0.32, 180, 60)], [(0.0, 0.95), (0.55, 0.95)]),
    "g": (_O, [(0.8, 1.0), *_bow(0.42, -0.14, 0.38, 0.38, 0, -150)]),
    "h": (_TALL, _SHOULDER),
    "i": (_STEM, [(0.0, 1.42), (0.0, 1.46)]),
    "j": ([(0.2, 1.0), *_bow(-0.1, -0.2, 0.3, 0.32, 0, -100)], [(0.2, 1.42), (0.2, 1.46)]),
    "k": (_TALL, [(0.62, 1.0), (0.05, 0.45)], [(0.22, 0.6), (0.66, 0.0)]),
    "l": (_TALL,),
    "m": (
        _STEM,
        [*_bow(0.32, 0.64, 0.28, 0.36, 150, 0), (0.60, 0.0)],
        [*_bow(0.90, 0.64, 0.28, 0.36, 160, 0), (1.18, 0.0)],
    ),
    "n": (_STEM, _SHOULDER),
    "o": (_O,),
    "p": ([(0.0, -0.55), (0.0, 1.0)], _O),
    "q": (_O, [(0.8, -0.55), (0.8, 1.0)]),
    "r": (_STEM, _bow(0.36, 0.60, 0.34, 0.40, 150, 50)),
    "s": (
        [*_bow(0.32, 0.75, 0.27, 0.25, 40, 180), *_bow(0.32, 0.26, 0.30, 0.26, 60, -150)],
    ),
    "t": ([(0.2, 1.38), *_bow(0.46, 0.26, 0.26, 0.26, 180, 300)], [(0.0, 0.95), (0.55, 0.95)]),
    "u": (_CUP, [(0.7, 1.0), (0.7, 0.0)]),
    "v": ([(0.0, 1.0), (0.38, 0.0), (0.76, 1.0)],),
    "w": ([(0.0, 1.0), (0.28, 0.0), (0.56, 0.9), (0.84, 0.0), (1.12, 1.0)],),
    "x": ([(0.0, 1.0), (0.70, 0.0)], [(0.70, 1.0), (0.0, 0.0)]),
    "y": ([(0.0, 1.0), (0.38, 0.05)], [(0.76, 1.0), (0.38, 0.05), (0.20, -0.5), (0.02, -0.52)]),
    "z": ([(0.0, 0.97), (0.62, 0.97), (0.0, 0.03), (0.66, 0.03)],),
    "A": ([(0.0, 0.0), (0.56, 1.5), (1.12, 0.0)], [(0.2, 0.52), (0.92, 0.52)]),
    "E": ([(0.8, 1.48), (0.0, 1.48), (0.0, 0.02), (0.84, 0.02)], [(0.0, 0.8), (0.66, 0.8)]),
    "I": ([(0.0, 0.0), (0.0, 1.5)],),
    "K": (
        [(0.0, 0.0), (0.0, 1.5)],
        [(0.85, 1.5), (0.05, 0.65)],
        [(0.30, 0.92), (0.92, 0.0)],
    ),
    "L": ([(0.0, 1.5), (0.0, 0.03), (0.78, 0.03)],),
    "M": ([(0.0, 0.0), (0.0, 1.5), (0.55, 0.35), (1.1, 1.5), (1.1, 0.0)],),
    "N": ([(0.0, 0.0), (0.0, 1.5), (0.94, 0.0), (0.94, 1.5)],),
    "B": (
        [(0.0, 0.0), (0.0, 1.48), (0.4, 1.48), *_bow(0.42, 1.13, 0.34, 0.35, 90, -90), (0.0, 0.78)],
        [(0.4, 0.78), *_bow(0.44, 0.40, 0.40, 0.38, 90, -90), (0.0, 0.02)],
    ),
    "O": (_bow(0.6, 0.75, 0.6, 0.75, 0, 360),),
    "R": (
        [(0.0, 0.0), (0.0, 1.48), (0.4, 1.48), *_bow(0.44, 1.1, 0.38, 0.38, 90, -90), (0.0, 0.72)],
        [(0.38, 0.72), (0.88, 0.0)],
    ),
    "S": (
        [*_bow(0.44, 1.12, 0.38, 0.38, 35, 200), *_bow(0.44, 0.38, 0.42, 0.40, 70, -150)],
    ),
    "T": ([(0.0, 1.47), (1.06, 1.47)], [(0.53, 1.47), (0.53, 0.0)]),
    "W": ([(0.0, 1.5), (0.36, 0.0), (0.74, 1.3), (1.12, 0.0), (1.48, 1.5)],),
    "Y": ([(0.0, 1.5), (0.5, 0.72), (1.0, 1.5)], [(0.5, 0.72), (0.5, 0.0)]),
    ".": ([(0.05, 0.02), (0.05, 0.06)],),
    ",": ([(0.10, 0.05), (0.02, -0.22)],),
}  # fmt: skip
"""The strokes of each character that can be written; there are also spaces."""


def measure_text(text: str, size: float) -> float:
    """Return the width of a text whose small x is `size` high, in the unit of `size`."""
    return size * sum(map(_advance, text))


def draw_text_line(text: str, size_px: float) -> Coverage:
    """Return a line of text whose small x is `size_px` high: (rows, cols) float32, 0 to 1.

    The base line is `TOP` times `size_px` below the top edge. Raises KeyError for a character that
    the font does not have.
    """
    rows = math.ceil((TOP - _BOTTOM) * size_px)
    image = np.zeros((rows, math.ceil(measure_text(text, size_px)) + 2), dtype=np.float32)
    place = 0.0
    for character in text:
        if character != " ":
            # Half a pixel is near enough for the eye, and leaves few tiles to draw.
            left, shift = divmod(round(2.0 * place), 2)
            tile = _tile(character, size_px, shift / 2.0)[:, : image.shape[1] - left]
            there = image[:, left : left + tile.shape[1]]
            np.maximum(there, tile, out=there)
        place += size_px * _advance(character)
    return image


@cache
def _advance(character: str) -> float:
    """Return how far a character moves the pen on, in heights of a small x."""
    if character == " ":
        return _SPACE
    right = max(x for stroke in STROKES[character] for x, _ in stroke)
    return right + 2.0 * _PEN[0] + _GAP


@lru_cache(maxsize=512)
def _tile(character: str, size_px: float, shift_px: float) -> Coverage:
    """Return one letter, its left edge `shift_px` from the left of its image."""
    rows = math.ceil((TOP - _BOTTOM) * size_px)
    cols = math.ceil(size_px * _advance(character) + shift_px)
    x = (np.arange(cols) + 0.5 - shift_px) / size_px - _PEN[0]
    y = TOP - (np.arange(rows) + 0.5) / size_px
    # The pen is an ellipse: in units of its half widths it is a circle, and distances are plain.
    points = np.stack(np.meshgrid(x / _PEN[0], y / _PEN[1]), axis=-1)[..., None, :]
    lines = [
        (start, stop) for stroke in STROKES[character] for start, stop in itertools.pairwise(stroke)
    ]
    ends = np.array(lines) / _PEN
    start, way = ends[:, 0], ends[:, 1] - ends[:, 0]
    part = ((points - start) * way).sum(axis=-1) / (way**2).sum(axis=-1)
    nearest = start + np.clip(part, 0.0, 1.0)[..., None] * way
    distance = np.sqrt(((points - nearest) ** 2).sum(axis=-1)).min(axis=-1)
    # Half covered where the edge runs through the pixel's middle.
    soft = size_px * math.sqrt(_PEN[0] * _PEN[1])
    covered: Coverage = np.clip(0.5 + (1.0 - distance) * soft, 0.0, 1.0).astype(np.float32)
    return covered
