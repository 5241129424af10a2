"""Pictures of a finder: linear light as the 8 bits that a screen shows, and back."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats

_STEPS = 4095
"""Steps of light in the table: finer than 8 bits need, except for the darkest."""
_USUAL, _BRIGHT = 0.6, 0.98
"""Light that a finder gives to the brighter parts of a picture, and the share of darker pixels."""


def _make_tables() -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Levels by steps of light, and light by levels: the curve of IEC 61966-2-1."""
    light = np.arange(_STEPS + 1) / _STEPS
    curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    level = np.arange(256) / 255.0
    back = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    return np.rint(255.0 * curve).astype(np.uint8), back.astype(np.float32)


_LEVELS, _LIGHT = _make_tables()


def draw_finder_picture(light: Floats) -> NDArray[np.uint8]:
    """Linear light, 1 being white, as sRGB of 8 bits. For finders that have samples."""
    steps = np.clip(np.nan_to_num(light) * _STEPS + 0.5, 0.0, _STEPS)
    return np.asarray(_LEVELS[steps.astype(np.uint16)])


def read_finder_light(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The light of a picture, 0..1, of the same shape; the mean of its colours, if it has any."""
    light = cv2.LUT(np.ascontiguousarray(picture), _LIGHT)
    if picture.ndim == 3:
        light = cv2.transform(light, np.full((1, 3), 1.0 / 3.0))
    return np.asarray(light, np.float32)


def choose_finder_gain(light: Floats) -> float:
    """The factor on light that makes its brighter parts well visible, as a finder exposes by
    itself; `inf` where there is no light."""
    bright = float(np.quantile(light, _BRIGHT))
    return _USUAL / bright if bright > 0.0 else float("inf")
