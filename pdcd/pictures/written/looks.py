"""How the pictures of a run are shown: with one white balance, and by one measure of brightness.

White balance is a factor each of red, green and blue that makes something white grey. Scene units
are balanced already as far as the camera's responsivity is known. What is left is small, unless
that is only a nominal one; so a thing counts as white only where it nearly is.

The measure of brightness is the white photo, or the brightest picture where there is none. The
power of two that belongs to a picture lets light a hundred times weaker be seen, and still be
compared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Singles

_Source = Literal["patch", "white photo", "camera"]

_PATCH = 1.0 / 24.0
"""Side of the square that is taken for the white patch, over the height of the field."""
_DARK_PATCH = 0.1
"""... and a patch darker than that share of the brightest is no white one."""
_BRIGHT = 0.5
"""What may be white in the white photo is at least so bright, as a share of its brightest."""
_BRIGHTEST_PERCENT = 99.0
_NEUTRAL = 1.5
"""... and its strongest channel at most so many times its weakest."""
_FEWEST = 0.005
"""... and takes at least such a share of the picture."""
WHITE_PICTURE = "white"
"""Name of the picture of all light."""
LEVEL, LEVEL_PERCENT = 0.9, 99.0
"""The brightest hundredth of the white photo is shown as 0.9 or brighter, 1 being white."""
_DARK_HALF, _FEW_PERCENT = 0.02, 95.0
"""Where half of a picture would be shown darker than that, as a few glints are so much brighter,
the brightest twentieth counts instead."""
_MOST_CUT = 16.0
"""... which are cut off at no less than that share of what their brightest hundredth reaches."""
_NEGATIVE, _SURE = 0.25, 4.0
"""A picture is signed where a hundredth of it lies below minus that share of its brightest light,
and below minus so many sigmas."""
_MOST_FACTOR = 4096.0
_MOST_NOISE = 0.125
"""A picture is not brightened until its usual sigma is shown as more than that, 1 being white."""
_ENOUGH_PX = 400
"""Rows and columns that are enough to find a median or a percentile."""


@dataclass(frozen=True)
class WhiteBalance:
    """`factors` of (R, G, B), green 1: green keeps its scene units; of grey pictures (1,).
    `source`: what was taken for white; "camera" leaves the pictures as the responsivity of the
    camera makes them."""

    factors: tuple[float, ...]
    source: _Source = "camera"

    @classmethod
    def none(cls, image: Singles) -> WhiteBalance:
        """That of the camera, of pictures such as this one, (..., C)."""
        return cls((1.0,) * image.shape[-1])


def balance_of(
    pictures: Mapping[str, tuple[Singles, Bools]], patch: tuple[float, float] | None
) -> WhiteBalance:
    """Of the pictures of one run on the whole field, by name: by the patch, where one was named and
    can be seen, else by the white photo. Each is (H, W, C) float32, and where it is known, (H, W).
    """
    lit = pictures.get(WHITE_PICTURE)
    if patch is not None:
        found = balance_by_patch(*(lit or next(iter(pictures.values()))), patch)
        if found is not None:
            return found
    if lit is None:
        return WhiteBalance.none(next(iter(pictures.values()))[0])
    image, known = lit
    step = choose_pixel_step(known)
    return balance_by_white_photo(image[::step, ::step], known[::step, ::step])


def balance_by_white_photo(picture: Singles, known: Bools) -> WhiteBalance:
    """By what is bright and nearly neutral in a white photo; the camera's own where nothing is.

    picture : (H, W, 3) float32, linear; known : (H, W) bool.
    """
    light = picture[known]
    if not light.size:
        return WhiteBalance.none(picture)
    bright = light[_sum(light) >= _BRIGHT * _brightest(light)]
    weakest = bright.min(axis=1)
    neutral = bright[(weakest > 0.0) & (bright.max(axis=1) <= _NEUTRAL * weakest)]
    if len(neutral) < _FEWEST * len(light):
        return WhiteBalance.none(picture)
    return WhiteBalance(_factors(neutral), "white photo")


def balance_by_patch(
    picture: Singles, known: Bools, place: tuple[float, float]
) -> WhiteBalance | None:
    """By a square patch about a place; None where nothing is known of it, or it is dark.

    picture : (H, W, 3) float32, linear, of the whole field; known : (H, W) bool.
    place : (x, y) on the field, 0 to 1 each; the square ends where the field does.
    """
    height, width = known.shape
    half = max(0.5 * _PATCH * height, 0.5)
    rows, cols = (
        slice(max(math.floor(at * length - half), 0), max(math.ceil(at * length + half), 1))
        for at, length in ((place[1], height), (place[0], width))
    )
    light = picture[rows, cols][known[rows, cols]]
    if not light.size:
        return None
    mean = light.mean(axis=0, dtype=np.float64)
    if not (mean > 0.0).all() or mean.sum() < _DARK_PATCH * _brightest(picture[known]):
        return None
    return WhiteBalance(_factors(light), "patch")


def _brightest(light: Singles) -> float:
    """Of colours (n, C): the sum of the channels that the brightest of them reach."""
    return float(np.percentile(_sum(light), _BRIGHTEST_PERCENT))


def _sum(light: Singles) -> Singles:
    """Of colours (n, C), (n,)."""
    return light @ np.ones(light.shape[1], np.float32)


def _factors(light: Singles) -> tuple[float, ...]:
    """From colours (n, C) that are white on average."""
    each = light.mean(axis=0, dtype=np.float64).tolist()
    return tuple(each[len(each) // 2] / one for one in each)


@dataclass(frozen=True)
class ToneStats:
    """What decides on how a picture is drawn, in scene units: how bright it is, what its darkest
    hundredth stays below, and its usual sigma."""

    bright: float
    sigma: float
    dark: float = 0.0

    @classmethod
    def of(cls, image: NDArray[np.floating], known: NDArray[np.bool_], sigma: float) -> ToneStats:
        """Of an image (h, w, 3), known at some pixels (h, w)."""
        step = choose_pixel_step(known)
        values = image[::step, ::step][known[::step, ::step]]
        if not values.size:
            return cls(0.0, sigma)
        shares = 100.0 - LEVEL_PERCENT, 50.0, _FEW_PERCENT, LEVEL_PERCENT
        dark, middle, most, bright = (float(v) for v in np.percentile(values, shares))
        if middle * LEVEL < _DARK_HALF * bright:
            bright = max(most, bright / _MOST_CUT)
        return cls(bright, sigma, dark)

    @property
    def signed(self) -> bool:
        """Whether there is light below 0 to be seen."""
        return -self.dark > max(_NEGATIVE * self.bright, _SURE * self.sigma)

    @property
    def reach(self) -> float:
        """What is to be shown as all but white; of a signed picture, or as all but black."""
        return max(self.bright, -self.dark) if self.signed else self.bright


class Brightness:
    """Of the pictures of one run, by name."""

    def __init__(self, looks: Mapping[str, ToneStats]) -> None:
        self._looks = looks
        first = (
            WHITE_PICTURE
            if WHITE_PICTURE in looks
            else max(looks, key=lambda name: looks[name].reach)
        )
        level = max(looks[first].reach, looks[first].sigma * LEVEL / _MOST_NOISE)
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
            most = min(most, max(_MOST_NOISE / noise, 1.0))
        # A little more, so that rounding does not halve what just reaches the level.
        return float(2.0 ** math.floor(math.log2(min(most, _MOST_FACTOR) * (1.0 + 1e-6))))


def choose_pixel_step(known: NDArray[np.bool_]) -> int:
    """Every so many pixels are looked at of a picture (h, w)."""
    return max(math.isqrt(known.size) // _ENOUGH_PX, 1)


def compute_median_sigma(sigma: NDArray[np.floating], known: NDArray[np.bool_]) -> float:
    """The median error of the known pixels of (h, w, 3); 0 without any."""
    step = choose_pixel_step(known)
    values = sigma[::step, ::step][known[::step, ::step]]
    return float(np.median(values)) if values.size else 0.0
