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
DARK, FEW_PERCENT = 0.02, 95.0
"""Where half of a picture would be shown darker than that, as a few glints are so much brighter,
the brightest twentieth counts instead."""
MOST_CUT = 16.0
"""... which are cut off at no less than that share of what their brightest hundredth reaches."""
NEGATIVE, SURE = 0.25, 4.0
"""A picture is signed where a hundredth of it lies below minus that share of its brightest light,
and below minus so many sigmas."""
MOST_FACTOR = 4096.0
MOST_NOISE = 0.125
"""A picture is not brightened until its usual sigma is shown as more than that, 1 being white."""
ENOUGH_PX = 400
"""Rows and columns that are enough to find a median or a percentile."""


@dataclass(frozen=True)
class Look:
    """What decides on how a picture is drawn, in scene units: how bright it is, what its darkest
    hundredth stays below, and its usual sigma."""

    bright: float
    sigma: float
    dark: float = 0.0

    @classmethod
    def of(cls, image: NDArray[np.floating], known: NDArray[np.bool_], sigma: float) -> Look:
        """Of an image (h, w, 3), known at some pixels (h, w)."""
        step = step_of(known)
        values = image[::step, ::step][known[::step, ::step]]
        if not values.size:
            return cls(0.0, sigma)
        shares = 100.0 - LEVEL_PERCENT, 50.0, FEW_PERCENT, LEVEL_PERCENT
        dark, middle, most, bright = (float(v) for v in np.percentile(values, shares))
        if middle * LEVEL < DARK * bright:
            bright = max(most, bright / MOST_CUT)
        return cls(bright, sigma, dark)

    @property
    def signed(self) -> bool:
        """Whether there is light below 0 to be seen."""
        return -self.dark > max(NEGATIVE * self.bright, SURE * self.sigma)

    @property
    def reach(self) -> float:
        """What is to be shown as all but white; of a signed picture, or as all but black."""
        return max(self.bright, -self.dark) if self.signed else self.bright


class Brightness:
    """Of the pictures of one run, by name."""

    def __init__(self, looks: Mapping[str, Look]) -> None:
        self._looks = looks
        first = WHITE if WHITE in looks else max(looks, key=lambda name: looks[name].reach)
        level = max(looks[first].reach, looks[first].sigma * LEVEL / MOST_NOISE)
        self.scale = LEVEL / level if level > 0.0 else 1.0
        """What a scene unit of a picture with the factor 1 is shown as, 1 being white."""

    def signed(self, name: str) -> bool:
        """Whether a picture is drawn around a middle grey that is 0."""
        return self._looks[name].signed

    def factor(self, name: str) -> float:
        """How much brighter a picture is drawn than the white one: a power of two."""
        look = self._looks[name]
        shown = look.reach * self.scale
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


def usual(sigma: NDArray[np.floating], known: NDArray[np.bool_]) -> float:
    """The median error of the known pixels of (h, w, 3); 0 without any."""
    step = step_of(known)
    values = sigma[::step, ::step][known[::step, ::step]]
    return float(np.median(values)) if values.size else 0.0
