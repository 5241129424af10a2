"""Each fault of a series of stripes by its name, at the edge of what is borne."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.registration.averaging import StripeAverager
from pdcd.calibration.registration.series_faults import (
    check_offset_range,
    check_same_stripe,
    check_series_consistency,
    check_stripe_contrast,
    check_stripe_direction,
    check_stripe_saturation,
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


def mostly(dark: int) -> Floats:
    """Stripes everywhere but at some places."""
    share = triangle()
    share[:dark] = 0.25
    return share


@pytest.mark.parametrize(
    ("share", "sigma", "words"),
    [
        (triangle(level=0.59), 1e-4, ""),
        (triangle(level=0.61), 1e-4, "gave 0.6 times the light"),
        (triangle(level=0.019, size=0.01), 1e-4, "the photos of stripes are black"),
        (np.full((N, STEPS), 0.45), 1e-4, "one of the panels shows no stripes"),
        (triangle(level=0.3, size=0.066), 1e-4, ""),
        (triangle(level=0.3, size=0.055), 1e-4, "the stripes do not modulate"),
        (mostly(N // 10 - 1), 1e-4, ""),
        (mostly(N // 10), 1e-4, "the stripes do not modulate"),
        (triangle(), 0.019, ""),
        (triangle(), 0.021, "the stripes do not modulate"),
    ],
)
def test_photos_without_stripes_tell_why(share: Floats, sigma: float, words: str) -> None:
    if not words:
        check_stripe_contrast(share, first_of(share), np.full(N, sigma))
        return
    with pytest.raises(CalibrationError, match=words):
        check_stripe_contrast(share, first_of(share), np.full(N, sigma))


def test_offsets_near_half_a_period_are_ambiguous() -> None:
    """But for a hundredth of them."""
    offsets = np.full((200, 2), 6.3)
    offsets[:2, 0] = -6.5
    check_offset_range(offsets, 16)
    offsets[:3, 0] = -6.5
    with pytest.raises(CalibrationError, match=r"6\.4 px or more apart: stripes of 16 px"):
        check_offset_range(offsets, 16)


@pytest.mark.parametrize("axis", [0, 1])
def test_periods_must_agree_to_a_pixel_in_both_directions(axis: int) -> None:
    beside = np.zeros((9, 2))
    beside[:, axis] = -0.99
    beside[0] = 50.0
    check_same_stripe(beside, 16)
    beside[1:, axis] = -1.01
    with pytest.raises(CalibrationError, match=r"stripes of 16 px .* further apart"):
        check_same_stripe(beside, 16)


def test_lit_quads_have_a_tenth_of_the_brightest_light_and_it_is_above_noise() -> None:
    white = np.full((20, 20), 100.0)
    white[0, :3] = 9.9, 10.1, np.nan
    found = find_lit_quads(white, np.ones((20, 20)))
    assert found.sum() == 398 and found[0, :3].tolist() == [False, True, False]
    assert find_lit_quads(np.full((9, 9), 5.1), np.ones((9, 9))).all()
    for dark in (np.full((9, 9), 4.9), np.full((9, 9), np.nan), np.zeros((9, 9))):
        with pytest.raises(CalibrationError, match="there is no light"):
            find_lit_quads(dark, np.ones((9, 9)))


@pytest.mark.parametrize(
    ("columns", "beside", "enough"), [(10, 0.0, True), (9, 0.0, False), (16, 4.9, False)]
)
def test_three_fifths_of_the_field_must_be_measured(
    columns: int, beside: float, enough: bool
) -> None:
    """Of 16 columns of the field, each 10 quads wide, as many have a place; it counts as measured
    within two periods and a half of one."""
    camera = Map.filling((160, 120))
    x, y = np.meshgrid(np.arange(columns) * 10.0 + 5.0 + beside, np.arange(12) * 10.0 + 5.0)
    places = np.stack([x.ravel(), y.ravel()], axis=-1)
    check_window_coverage(places, camera, 2.0 if enough or beside else 5.0)
    if not enough:
        with pytest.raises(CalibrationError, match="of the field only; 60%"):
            check_window_coverage(places, camera, 1.0)
