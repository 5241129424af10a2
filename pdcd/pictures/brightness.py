"""How brightly the pictures of one run are shown: all by one measure, times powers of two.

The measure is the white photo, or the brightest picture where there is none. The power of two that
belongs to a picture lets light a hundred times weaker be seen, and still be compared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WHITE = "white"
"""Name of the picture of all light."""
LEVEL, LEVEL_PERCENT = 0.9, 99.0
"""The brightest hundredth of the white photo is shown as 0.9 or brighter, 1 being white."""
MOST_FACTOR = 4096.0
MOST_NOISE = 0.125
"""A picture is not brightened until its usual sigma is shown as more than that, 1 being white."""
ENOUGH_PX = 400
"""Rows and columns that are enough to find a median or a percentile."""


@dataclass(frozen=True)
class Look:
    """What decides on a picture's brightness, in scene units: what its brightest hundredth reaches,
    and its usual sigma."""

    bright: float
    sigma: float


class Brightness:
    """Of the pictures of one run, by name."""

    def __init__(self, looks: Mapping[str, Look]) -> None:
        self._looks = looks
        first = WHITE if WHITE in looks else max(looks, key=lambda name: looks[name].bright)
        level = max(looks[first].bright, looks[first].sigma * LEVEL / MOST_NOISE)
        self.scale = LEVEL / level if level > 0.0 else 1.0
        """What a scene unit of a picture with the factor 1 is shown as, 1 being white."""

    def factor(self, name: str) -> float:
        """How much brighter a picture is drawn than the white one: a power of two."""
        look = self._looks[name]
        shown = look.bright * self.scale
        if shown <= 0.0:
            return 1.0
        most = LEVEL / shown
        noise = look.sigma * self.scale
        if noise > 0.0:
            most = min(most, max(MOST_NOISE / noise, 1.0))
        # A little more, so that rounding does not halve what just reaches the level.
        return float(2.0 ** math.floor(math.log2(min(most, MOST_FACTOR) * (1.0 + 1e-6))))


def step_of(known: NDArray[np.bool_]) -> int:
    """Every so many pixels are looked at of a picture (h, w)."""
    return max(math.isqrt(known.size) // ENOUGH_PX, 1)


def brightest(image: NDArray[np.floating], known: NDArray[np.bool_]) -> float:
    """What the brightest hundredth of the known pixels of (h, w, 3) reaches; 0 without any."""
    step = step_of(known)
    values = image[::step, ::step][known[::step, ::step]]
    return float(np.percentile(values, LEVEL_PERCENT)) if values.size else 0.0


def usual(sigma: NDArray[np.floating], known: NDArray[np.bool_]) -> float:
    """The median error of the known pixels of (h, w, 3); 0 without any."""
    step = step_of(known)
    values = sigma[::step, ::step][known[::step, ::step]]
    return float(np.median(values)) if values.size else 0.0
