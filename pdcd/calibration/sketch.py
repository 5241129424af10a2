"""Pictures of what a step found, to look at: fields of arrows, curves of numbers, lines of text."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]
Box = tuple[int, int, int, int]
"""Left, top, width, height in pixels of the picture."""

MOST_ARROWS = 900
"""Vectors that are drawn of a field; more would cover each other."""
SIZE = (900, 600)
WHITE, GREY, BLACK, BLUE, RED = (
    (255, 255, 255),
    (170, 170, 170),
    (0, 0, 0),
    (30, 80, 200),
    (200, 40, 30),
)
FINEST = 16
"""Parts of a pixel of the picture that lines are placed to: 2 to the fourth."""
LONGEST = 0.06
"""Length of an arrow that only 5 % exceed, over the width of its box."""
LINE_PX = 18
"""Height of a line of text."""


def blank(size: tuple[int, int] = SIZE) -> Picture:
    """A white picture, (height, width, 3)."""
    return np.full((size[1], size[0], 3), 255, dtype=np.uint8)


def write(
    on: Picture,
    lines: Sequence[str],
    left: int,
    top: int,
    colour: tuple[int, int, int] = BLACK,
) -> None:
    """Lines of text, one below the other, from the upper left."""
    for number, line in enumerate(lines):
        at = (left, top + 13 + LINE_PX * number)
        cv2.putText(on, line, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, 1, cv2.LINE_AA)


def arrows(
    on: Picture, box: Box, places: Floats, vectors_px: Floats, title: str, unit: str = "px"
) -> None:
    """Vectors at places of a field, so much enlarged that they can be seen, with a measure; of many
    vectors some, evenly.

    places : (n, 2), 0..1 right and down over the box. vectors_px : (n, 2).
    """
    left, top, width, height = box
    cv2.rectangle(on, (left, top), (left + width, top + height), GREY, 1)
    good = np.isfinite(places + vectors_px).all(axis=-1)
    places, vectors_px = places[good], vectors_px[good]
    lengths = np.hypot(vectors_px[:, 0], vectors_px[:, 1])
    usual = float(np.quantile(lengths, 0.95)) if lengths.size else 0.0
    measure = _round(max(usual, 1e-6))
    scale = LONGEST * width / measure
    tails = places * (width, height) + (left, top)
    tips = tails + vectors_px * scale
    some = slice(None, None, max(1, len(tails) // MOST_ARROWS))
    for tail, tip, length in zip(tails[some], tips[some], lengths[some], strict=True):
        colour = RED if length > 3.0 * measure else BLUE
        _line(on, tail, tip, colour)
        cv2.circle(on, (round(float(tail[0])), round(float(tail[1]))), 1, colour, -1, cv2.LINE_AA)
    write(on, [title], left, top - 20)
    below = top + height + 10
    _line(on, np.array([left, below + 4.0]), np.array([left + scale * measure, below + 4.0]), BLACK)
    text = f"{measure:g} {unit}; 95 % below {usual:.3f} {unit}"
    write(on, [text], left + round(scale * measure) + 8, below - 5)


def curve(
    on: Picture,
    box: Box,
    x: Floats,
    values: Floats,
    title: str,
    fit: Floats | None = None,
) -> None:
    """Points (n,), and what was fitted to them as a line (n,)."""
    left, top, width, height = box
    cv2.rectangle(on, (left, top), (left + width, top + height), GREY, 1)
    both = values if fit is None else np.concatenate([values, fit])
    low, high = float(np.nanmin(both)), float(np.nanmax(both))
    first, last = float(x.min()), float(x.max())

    def at(some_x: Floats, some: Floats) -> Floats:
        across = (some_x - first) / max(last - first, 1e-12)
        up = (some - low) / max(high - low, 1e-12)
        return np.stack(
            [left + 10 + across * (width - 20), top + height - 10 - up * (height - 20)], axis=-1
        )

    if fit is not None:
        points = at(x, fit)
        for one, two in pairwise(points):
            _line(on, one, two, GREY)
    for right, down in at(x, values).tolist():
        cv2.circle(on, (round(right), round(down)), 3, BLUE, -1, cv2.LINE_AA)
    write(on, [title], left, top - 20)
    write(on, [f"{low:.3g} to {high:.3g}"], left, top + height + 4)


def _line(on: Picture, one: Floats, two: Floats, colour: tuple[int, int, int]) -> None:
    ends = [tuple(np.round(end * FINEST).astype(int).tolist()) for end in (one, two)]
    cv2.line(on, ends[0], ends[1], colour, 1, cv2.LINE_AA, 4)


def _round(value: float) -> float:
    """The nearest of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(min((1.0, 2.0, 5.0, 10.0), key=lambda n: abs(np.log(n * power / value))) * power)
