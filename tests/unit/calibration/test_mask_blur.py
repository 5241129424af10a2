"""Blur on the mask out of two periods of stripes, against the Fourier transform of a Gaussian."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.registration.mask_blur import MaskBlur, measure_mask_blur
from pdcd.calibration.registration.offsets import StripeSeries
from pdcd.calibration.registration.stripes import StripePlan, compute_pixel_attenuation
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map

Floats = NDArray[np.float64]

SIZE = 64, 48
DEVICE = Map.filling(SIZE)
QUADS = np.stack(np.meshgrid(np.arange(2.0, 64.0, 4.0), np.arange(2.0, 48.0, 4.0)), axis=-1)
PLACES = QUADS.reshape(-1, 2)
COARSE, FINE = 32, 8


def series(axis: int, period_px: int, sigma_px: Floats, noise: float = 1e-4) -> StripeSeries:
    """Stripes of half the light whose first harmonic a Gaussian has passed; of higher ones, which
    blurs from 1.5 px on take away, there are none."""
    stripes = StripePlan(axis, period_px)
    slope = np.zeros((len(PLACES), 2))
    slope[:, axis] = 1.0  # a pixel of the mask is one of the projector
    left = np.exp(-2.0 * np.pi**2 * sigma_px**2 / period_px**2)
    depth = 0.7 * compute_pixel_attenuation(stripes, slope) * left
    share = np.full((len(PLACES), stripes.steps), 0.5)
    first = 0.25 * depth * np.exp(2j * np.pi * 0.3 / period_px)
    return StripeSeries(stripes, PLACES, share, first, np.full(len(PLACES), noise))


def measured(right_px: Floats, down_px: Floats, noise: float = 1e-4) -> MaskBlur:
    blurs = (right_px, down_px)
    coarse = [series(axis, COARSE, each) for axis, each in enumerate(blurs)]
    fine = [series(axis, FINE, each, noise) for axis, each in enumerate(blurs)]
    return measure_mask_blur(coarse, fine, DEVICE, DEVICE, DEVICE)


def alike(value: float) -> Floats:
    return np.full(len(PLACES), value)


@pytest.mark.parametrize(("right_px", "down_px"), [(1.5, 1.5), (1.5, 2.0), (2.5, 1.8)])
def test_each_axis_has_its_own_blur(right_px: float, down_px: float) -> None:
    found = measured(alike(right_px), alike(down_px))
    np.testing.assert_allclose(found.blur_px, [right_px, down_px], rtol=0.01)
    np.testing.assert_allclose(found.by_cell_px[..., 0], right_px, rtol=0.01)
    np.testing.assert_allclose(found.by_cell_px[..., 1], down_px, rtol=0.01)
    assert found.by_cell_px.shape == (3, 4, 2)
    assert found.both_px == pytest.approx(np.sqrt((right_px**2 + down_px**2) / 2), rel=0.01)
    assert found.worst_px == pytest.approx(max(right_px, down_px), rel=0.01)


def test_parts_of_the_field_are_told_apart() -> None:
    """More blur in the right quarter, and in the lower third."""
    right = np.where(PLACES[:, 0] > 48.0, 2.4, 1.6)
    down = np.where(PLACES[:, 1] > 32.0, 2.4, 1.6)
    cells = measured(right, down).by_cell_px
    np.testing.assert_allclose(cells[:, :3, 0], 1.6, rtol=0.01)
    np.testing.assert_allclose(cells[:, 3, 0], 2.4, rtol=0.01)
    np.testing.assert_allclose(cells[:2, :, 1], 1.6, rtol=0.01)
    np.testing.assert_allclose(cells[2, :, 1], 2.4, rtol=0.01)


def test_the_error_of_a_blur_is_that_of_the_mean_of_its_places() -> None:
    rng = np.random.default_rng(2)
    spread = 0.05
    found = measured(*(alike(1.8) + rng.normal(0.0, spread, (2, len(PLACES)))))
    assert found.sigma_px.shape == found.blur_px.shape == (2,)
    np.testing.assert_allclose(found.sigma_px, spread / np.sqrt(len(PLACES)), rtol=0.2)


def test_stripes_that_noise_hides_tell_no_blur() -> None:
    first = np.median(np.abs(series(0, FINE, alike(2.0)).first))
    with pytest.raises(CalibrationError, match="stripes of 8 px are blurred away on the mask"):
        measured(alike(2.0), alike(2.0), 0.5 * float(first))
