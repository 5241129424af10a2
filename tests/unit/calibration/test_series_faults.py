"""Each fault of a series of stripes by its name, at the edge of what is borne."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.registration.averaging import StripeAverager
from pdcd.calibration.registration.series_faults import (
    check_offset_range,
    check_series_consistency,
    check_stripe_contrast,
    check_stripe_direction,
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


def test_lit_quads_have_a_tenth_of_the_brightest_light() -> None:
    white = np.full((20, 20), 100.0)
    white[0, :3] = 9.9, 10.1, np.nan
    found = find_lit_quads(white, np.ones((20, 20)))
    assert found.sum() == 398 and found[0, :3].tolist() == [False, True, False]
    for level, there in ((5.1, True), (4.9, False)):
        photo, variance = np.full((9, 9), level), np.ones((9, 9))
        if there:
            assert find_lit_quads(photo, variance).all()
        else:
            with pytest.raises(CalibrationError, match="there is no light") as caught:
                find_lit_quads(photo, variance)
            assert caught.value.device == "camera" and "lens cap" in str(caught.value.hint)
    part = np.full((9, 9), 4.9)
    part[:2] = 0.0
    for photo in (np.full((9, 9), np.nan), np.zeros((9, 9)), part):
        with pytest.raises(CalibrationError, match="there is no light"):
            find_lit_quads(photo, np.ones((9, 9)))


@pytest.mark.parametrize(("columns", "enough"), [(16, True), (10, True), (9, False), (0, False)])
def test_three_fifths_of_the_field_must_be_measured(columns: int, enough: bool) -> None:
    """Of 16 columns of the field, each 10 quads wide, as many have a place in the middle."""
    camera = Map.filling((160, 120))
    x, y = np.meshgrid(np.arange(columns) * 10.0 + 5.0, np.arange(12) * 10.0 + 5.0)
    places = np.stack([x.ravel(), y.ravel()], axis=-1)
    if enough:
        check_window_coverage(places, camera, 1.0)
        return
    with pytest.raises(CalibrationError, match=rf"on {columns / 16:.0%} of the field only; 60%"):
        check_window_coverage(places, camera, 1.0)


def test_stripes_that_modulate_at_most_places_are_enough() -> None:
    share = triangle(level=0.3, size=0.066)
    check_stripe_contrast(share, first_of(share), SURE)
    share = triangle(level=0.59)
    check_stripe_contrast(share, first_of(share), SURE)
    share = triangle()
    share[: N // 10 - 1] = 0.25
    check_stripe_contrast(share, first_of(share), SURE)
    share[: N // 10] = 0.25
    with pytest.raises(CalibrationError):
        check_stripe_contrast(share, first_of(share), SURE)
    noisy = triangle()
    with pytest.raises(CalibrationError):
        check_stripe_contrast(
            noisy, first_of(noisy), np.full(N, 0.021)
        )  # no more than noise would be
    check_stripe_contrast(noisy, first_of(noisy), np.full(N, 0.019))


@pytest.mark.parametrize("blur", [1.0, 0.95, 0.7])
def test_stripes_of_any_sharpness_are_no_change(blur: float) -> None:
    share = triangle(blur)
    check_series_consistency(share, first_of(share), SURE)


@pytest.mark.parametrize(("jump", "moved"), [(0.002, False), (0.02, True)])
def test_a_photo_that_does_not_fit_the_others_is_a_change(jump: float, moved: bool) -> None:
    share = triangle()
    share[:, 3] += jump
    if not moved:
        check_series_consistency(share, first_of(share), SURE)
        return
    with pytest.raises(
        CalibrationError, match=r"light changed: [2-5]\.\d% of the stripes"
    ) as found:
        check_series_consistency(share, first_of(share), SURE)
    assert found.value.device == "mask" and "warm up" in str(found.value.hint)
    # As much as the noise of single photos explains is none.
    for sigma in (0.004, 0.02):
        check_series_consistency(share, first_of(share), np.full(N, sigma))


def test_offsets_near_half_a_period_are_ambiguous() -> None:
    offsets = np.zeros((200, 2))
    offsets[:, 1] = 6.3
    check_offset_range(offsets, 16)
    offsets[:2, 0] = -6.5
    check_offset_range(offsets, 16)  # a hundredth may be
    offsets[:3, 0] = -6.5
    with pytest.raises(
        CalibrationError, match=r"6\.4 px or more apart: stripes of 16 px"
    ) as caught:
        check_offset_range(offsets, 16)
    assert caught.value.device == "mask" and "geometry" in str(caught.value.hint)


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
