"""White balance: factors of red, green and blue that make something white grey, one set a run.

Scene units are balanced already as far as the camera's responsivity is known. What is left is
small, unless that is only a nominal one; so a thing counts as white only where it nearly is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
Source = Literal["patch", "white photo", "camera"]

PATCH = 1.0 / 24.0
"""Side of the square that is taken for the white patch, over the height of the field."""
DARK = 0.1
"""... and a patch darker than that share of the brightest is no white one."""
BRIGHT = 0.5
"""What may be white in the white photo is at least so bright, as a share of its brightest."""
BRIGHTEST_PERCENT = 99.0
NEUTRAL = 1.5
"""... and its strongest channel at most so many times its weakest."""
FEWEST = 0.005
"""... and takes at least such a share of the picture."""

_SUM = np.ones(3, np.float32)


@dataclass(frozen=True)
class Balance:
    """`factors` of (R, G, B), green 1: green keeps its scene units. `source`: what was taken for
    white; "camera" leaves the pictures as the responsivity of the camera makes them."""

    factors: tuple[float, float, float] = (1.0, 1.0, 1.0)
    source: Source = "camera"


def by_white_photo(picture: Singles, known: Bools) -> Balance:
    """By what is bright and nearly neutral in a white photo; the camera's own where nothing is.

    picture : (H, W, 3) float32, linear; known : (H, W) bool.
    """
    light = picture[known]
    if not light.size:
        return Balance()
    bright = light[light @ _SUM >= BRIGHT * _brightest(light)]
    weakest = bright.min(axis=1)
    neutral = bright[(weakest > 0.0) & (bright.max(axis=1) <= NEUTRAL * weakest)]
    if len(neutral) < FEWEST * len(light):
        return Balance()
    return Balance(_factors(neutral), "white photo")


def by_patch(picture: Singles, known: Bools, place: tuple[float, float]) -> Balance | None:
    """By a square patch about a place; None where nothing is known of it, or it is dark.

    picture : (H, W, 3) float32, linear, of the whole field; known : (H, W) bool.
    place : (x, y) on the field, 0 to 1 each; the square ends where the field does.
    """
    height, width = known.shape
    half = max(0.5 * PATCH * height, 0.5)
    rows, cols = (
        slice(max(math.floor(at * length - half), 0), max(math.ceil(at * length + half), 1))
        for at, length in ((place[1], height), (place[0], width))
    )
    light = picture[rows, cols][known[rows, cols]]
    if not light.size:
        return None
    mean = light.mean(axis=0, dtype=np.float64)
    if not (mean > 0.0).all() or mean.sum() < DARK * _brightest(picture[known]):
        return None
    return Balance(_factors(light), "patch")


def _brightest(light: Singles) -> float:
    """Of colours (n, 3): the sum of the channels that the brightest of them reach."""
    return float(np.percentile(light @ _SUM, BRIGHTEST_PERCENT))


def _factors(light: Singles) -> tuple[float, float, float]:
    """From colours (n, 3) that are white on average."""
    red, green, blue = light.mean(axis=0, dtype=np.float64).tolist()
    return green / red, 1.0, green / blue
