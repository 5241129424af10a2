"""Each fault of a series of stripes by its name, at the edge of what is borne."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.registration.averaging import StripeAverager
from pdcd.calibration.registration.series_faults import (
    check_series_consistency,
    check_stripe_direction,
    check_stripe_saturation,
    check_window_coverage,
)
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map

Floats = NDArray[np.float64]

STEPS = 8
N = 50
PHASES = np.linspace(0.0, 6.0, N)


def triangle(blur: float = 1.0, level: float = 0.25, size: float = 0.2) -> Floats:
    """Light over white of stripes on stripes, (N, STEPS): a triangle whose odd harmonics are
    blurred."""
    phase = PHASES[:, None] - 2.0 * np.pi * np.arange(STEPS) / STEPS
    waves = sum(blur ** (n * n - 1) / n**2 * np.cos(n * phase) for n in range(1, 16, 2))
    return np.asarray(level + size * waves)


def first_of(share: Floats) -> NDArray[np.complex128]:
    """First harmonic over the photos."""
    return np.asarray(share @ np.exp(2j * np.pi * np.arange(STEPS) / STEPS) / STEPS)


SURE = np.full(N, 1e-4)


@pytest.mark.parametrize("blur", [1.0, 0.95, 0.7])
def test_stripes_of_any_sharpness_are_no_change(blur: float) -> None:
    share = triangle(blur)
    check_series_consistency(share, first_of(share), SURE)


def test_of_a_field_that_is_larger_than_the_photo_the_part_in_view_counts() -> None:
    """The photo sees the middle half of the field, either way, or nothing at all of it."""
    half = (0.5 / 160, 0.0, 0.25, 0.0, 0.5 / 120, 0.25, 0.0, 0.0, 1.0)
    x, y = np.meshgrid(np.arange(32) * 5.0 + 2.5, np.arange(24) * 5.0 + 2.5)
    places = np.stack([x.ravel(), y.ravel()], axis=-1)
    check_window_coverage(places, Map(size_px=(160, 120), homography=half), 3.0)
    beside = (0.5 / 160, 0.0, 1.25, 0.0, 0.5 / 120, 0.25, 0.0, 0.0, 1.0)
    with pytest.raises(CalibrationError, match="on 0% of the field"):
        check_window_coverage(places, Map(size_px=(160, 120), homography=beside), 3.0)


SHAPE = (48, 60)
AVERAGING = StripeAverager(np.ones(SHAPE, np.bool_), np.ones(SHAPE), 8.0, 1)
PLACES = AVERAGING.places(4.0)
CARRIER = np.exp(2j * np.pi * np.arange(60) / 8.0) * np.ones(SHAPE)


@pytest.mark.parametrize(
    ("turning", "words"),
    [
        (CARRIER, ""),
        (0.31 * CARRIER, ""),
        (0.29 * CARRIER, "not where the maps have them"),
        (np.conj(CARRIER), "run the wrong way"),
        (CARRIER + 1.9 * np.conj(CARRIER), ""),
        (CARRIER + 2.1 * np.conj(CARRIER), "run the wrong way"),
        (CARRIER.T[:48, :48].repeat(2, 1)[:, :60] * 0.0 + 1.0, "not where the maps have them"),
    ],
)
def test_stripes_of_the_mask_run_by_their_map(turning: NDArray[np.complex128], words: str) -> None:
    """In units of the product's depth."""
    first = np.ones(len(PLACES), np.complex128)
    if not words:
        check_stripe_direction(turning, CARRIER, first, AVERAGING, PLACES)
        return
    with pytest.raises(CalibrationError, match=words) as caught:
        check_stripe_direction(turning, CARRIER, first, AVERAGING, PLACES)
    assert caught.value.device == "mask" and caught.value.hint


def test_more_than_a_thousandth_of_lit_quads_saturated_is_refused() -> None:
    where = np.zeros((60, 50), np.bool_)
    where[:40] = True
    saturated = np.zeros((60, 50), np.bool_)
    saturated[50:] = True  # where nothing is lit that does not matter
    saturated[0, :2] = True
    check_stripe_saturation(saturated, where)
    check_stripe_saturation(None, where)
    saturated[0, :3] = True
    with pytest.raises(CalibrationError, match=r"0\.1% of the lit part") as caught:
        check_stripe_saturation(saturated, where)
    assert caught.value.device == "camera" and "expose less" in str(caught.value.hint)
