"""A field of arrows to look at: what a map leaves of its points, how things moved."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.charts import BLUE, GREY, INK, RED, Bytes, Colour, write

Floats = NDArray[np.float64]
Box = tuple[int, int, int, int]
"""Left, top, width, height in pixels of the picture."""

MOST_ARROWS = 900
"""Vectors that are drawn of a field; more would cover each other."""
FINEST = 16
"""Parts of a pixel of the picture that lines are placed to: 2 to the fourth."""
LONGEST = 0.06
"""Length of an arrow that only 5 % exceed, over the width of its box."""
CUT = 3.0
"""Times the measure from which an arrow is red, and cut to that."""


def arrows(
    on: Bytes, box: Box, places: Floats, vectors_px: Floats, title: str, unit: str = "px"
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
    # Cut: strangers are many times as long as the box is wide.
    drawn = np.minimum(1.0, CUT * measure / np.maximum(lengths, 1e-12))[:, None]
    tips = tails + vectors_px * (scale * drawn)
    some = slice(None, None, max(1, len(tails) // MOST_ARROWS))
    for tail, tip, length in zip(tails[some], tips[some], lengths[some], strict=True):
        colour = RED if length > CUT * measure else BLUE
        _line(on, tail, tip, colour)
        cv2.circle(on, (round(float(tail[0])), round(float(tail[1]))), 1, colour, -1, cv2.LINE_AA)
    write(on, [title], (left, top - 20))
    below = top + height + 10
    _line(on, np.array([left, below + 4.0]), np.array([left + scale * measure, below + 4.0]), INK)
    text = f"{measure:g} {unit}; 95 % below {usual:.3f} {unit}"
    write(on, [text], (left + round(scale * measure) + 8, below - 5))


def _line(on: Bytes, one: Floats, two: Floats, colour: Colour) -> None:
    ends = [tuple(np.round(end * FINEST).astype(int).tolist()) for end in (one, two)]
    cv2.line(on, ends[0], ends[1], colour, 1, cv2.LINE_AA, 4)


def _round(value: float) -> float:
    """The nearest of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(min((1.0, 2.0, 5.0, 10.0), key=lambda n: abs(np.log(n * power / value))) * power)
