"""Focus: depth of stripes on photos drawn stripe by stripe, and the best of a few."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.registration.focus import measure_stripe_depth
from pdcd.errors import CalibrationError

Floats = NDArray[np.float64]

PERIOD = 5.3


def photo(
    blur_quads: Floats | float, seed: int = 0, turn: float = 0.05, electrons: float = 8000.0
) -> QuadPhoto:
    """Stripes, a little turned, of a lamp that falls off, with the noise of a camera.

    blur_quads : of the whole photo, or of each quad (120, 160).
    """
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    place = (x + turn * y) / np.hypot(1.0, turn)
    blur = np.maximum(np.broadcast_to(blur_quads, place.shape), 1e-3)
    light, within = np.zeros(place.shape), np.mod(place, PERIOD)
    for edge in PERIOD * np.arange(-3.0, 4.0):
        light += ndtr((within - edge) / blur) - ndtr((within - edge - 0.5 * PERIOD) / blur)
    light *= electrons * (1.0 - 0.3 * ((x / 160 - 0.5) ** 2 + (y / 120 - 0.5) ** 2))
    variance = 0.5 * (light + 16.8**2)
    light = light + rng.normal(size=light.shape) * np.sqrt(variance)
    return QuadPhoto(*(np.repeat(each[..., None], 3, axis=2) for each in (light, variance)))


def test_depth_is_that_of_blurred_stripes() -> None:
    sharp, soft = (
        measure_stripe_depth(photo(0.05), PERIOD),
        measure_stripe_depth(photo(1.2), PERIOD),
    )
    assert sharp.number == pytest.approx(4.0 / np.pi, rel=0.02)
    kept = np.exp(-2.0 * np.pi**2 * (1.2**2 - 0.05**2) / PERIOD**2)
    assert soft.number / sharp.number == pytest.approx(kept, rel=0.02)
    assert soft.number_sigma < 0.02 * soft.number


def test_what_is_wrong_is_named() -> None:
    plain = photo(1.0)
    with pytest.raises(CalibrationError, match="no light"):
        measure_stripe_depth(photo(1.0, electrons=0.0), PERIOD)
    with pytest.raises(CalibrationError, match="saturated"):
        measure_stripe_depth(replace(plain, saturated=plain.light[..., 1] > 4000.0), PERIOD)
    with pytest.raises(CalibrationError, match="no stripes"):
        measure_stripe_depth(photo(6.0), PERIOD)
    with pytest.raises(CalibrationError, match="no stripes"):
        measure_stripe_depth(plain, 3.0 * PERIOD)  # wider ones were shown
