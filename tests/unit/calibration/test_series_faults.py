"""Faults of a series of stripes that no bench of `test_registration` has, and what is none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.registration.series_faults import (
    check_same_stripe,
    check_series_consistency,
    check_stripe_contrast,
    check_window_coverage,
    find_lit_quads,
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


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (np.full((N, STEPS), 0.45), "one of the panels shows no stripes"),
        (triangle(level=0.3, size=0.02), "the stripes do not modulate"),
    ],
)
def test_photos_without_stripes_tell_why(share: Floats, words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        check_stripe_contrast(share, first_of(share), SURE)


@pytest.mark.parametrize("axis", [0, 1])
def test_periods_must_agree_in_both_directions(axis: int) -> None:
    beside = np.zeros((9, 2))
    beside[0] = 50.0  # by most places
    check_same_stripe(beside, 16)
    beside[1:, axis] = -2.0
    with pytest.raises(CalibrationError, match=r"stripes of 16 px .* further apart"):
        check_same_stripe(beside, 16)


def test_numbers_that_are_none_are_no_light() -> None:
    white = np.full((20, 20), 100.0)
    white[0, :2] = np.nan
    assert find_lit_quads(white, np.ones((20, 20))).sum() == 398
    with pytest.raises(CalibrationError, match="there is no light"):
        find_lit_quads(np.full((9, 9), np.nan), np.ones((9, 9)))
