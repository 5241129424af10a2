"""Lamps that drift and flicker, and irises, by numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.calibration.figures import Verdict
from pdcd.calibration.light.lamp import Iris, Lamp, iris_of, iris_photos, lamp_of
from pdcd.calibration.photo import Photo
from pdcd.errors import CalibrationError
from pdcd.panels.frames import WHITE

TIMES = np.array([0.0, 10.0, 20.0, 30.0, 40.0])
ZIGZAG = np.array([1.0, -2.0, 2.0, -2.0, 1.0])
"""Neither a mean nor a slope."""


def test_drift_is_the_slope_and_flicker_what_is_left() -> None:
    levels = 500.0 * (1.0 + 1e-4 * (TIMES - 20.0) + 1e-3 * ZIGZAG)
    found = lamp_of(TIMES + 7.0, levels, noise=5e-4)
    middle = float(np.median(levels)) / 500.0
    assert found.drift_per_h == pytest.approx(0.36 / middle)
    spread = 14e-6 / 3.0 / middle**2
    assert found.flicker == pytest.approx(np.sqrt(spread - 25e-8))
    assert found.flicker_sigma == pytest.approx(np.sqrt(spread / 6.0))
    assert found.drift_sigma == pytest.approx(3600.0 * np.sqrt(spread / 1000.0))
    assert found.seconds == 40.0
    quiet = lamp_of(TIMES, levels, noise=0.01)
    assert quiet.flicker == 0.0
    assert quiet.drift_sigma == pytest.approx(3600.0 * 0.01 / np.sqrt(1000.0))


@pytest.mark.parametrize(
    ("times", "levels", "words", "device"),
    [
        (TIMES[:4], np.ones(4), "4 photos do not tell", "projector"),
        (np.full(5, 3.0), np.ones(5), "5 photos do not tell", "projector"),
        (TIMES, np.array([1.0, 1.0, 1.0, 1.0, 0.29]), "photo 5 of the series is dark", "shutter"),
        (TIMES, 1.0 + 0.0141 * ZIGZAG, "flickers by 3", "projector"),
        (TIMES, 1.0 + 0.16 / 40.0 * (TIMES - 20.0), r"changed by \+16 % in 40 s", "projector"),
        (TIMES, 1.0 - 0.16 / 40.0 * (TIMES - 20.0), "changed by -16 % in 40 s", "projector"),
    ],
)
def test_a_lamp_that_is_no_constant_light_is_refused(
    times: np.ndarray, levels: np.ndarray, words: str, device: str
) -> None:
    with pytest.raises(CalibrationError, match=words) as caught:
        lamp_of(times, levels)
    assert caught.value.device == device and caught.value.hint


def test_a_lamp_may_flicker_and_drift_a_little() -> None:
    assert lamp_of(TIMES, 1.0 + 0.0137 * ZIGZAG).flicker == pytest.approx(0.03, abs=1e-3)
    lamp_of(TIMES, 1.0 + 0.14 / 40.0 * (TIMES - 20.0))


@pytest.mark.parametrize(
    ("drift", "sigma", "flicker", "good"),
    [
        (0.03, 0.0, 0.005, (True, True)),
        (-0.031, 0.0, 0.0051, (False, False)),
        (0.05, 0.011, 0.0, (True, True)),
        (0.05, 0.009, 0.0, (False, True)),
    ],
)
def test_a_drift_is_doubtful_where_it_is_sure(
    drift: float, sigma: float, flicker: float, good: tuple[bool, bool]
) -> None:
    figures = Lamp(drift, sigma, flicker, 1e-4, 40.0).figures()
    assert [f.name for f in figures] == ["light.lamp_drift", "light.lamp_flicker"]
    assert tuple(f.verdict is Verdict.GOOD for f in figures) == good
    assert [(f.value, f.sigma, f.unit) for f in figures] == [
        (drift, sigma, "1/h"),
        (flicker, 1e-4, ""),
    ]
    assert [f.limit for f in figures] == ["within 0.03", "0.005 or less"]


def test_patches_are_five_hundredths_of_the_picture() -> None:
    dark, bright = iris_photos((400, 300), 60)
    assert (dark.name, bright.name) == ("iris-dark", "iris-bright")
    for shown in (dark, bright):
        assert shown.refreshes == 60 and (shown.mask_index == WHITE).all()
        assert shown.projector.shape == (1, 300, 400)
    assert dark.projector.mean() == pytest.approx(0.05, abs=0.002)
    assert bright.projector.mean() == pytest.approx(0.95, abs=0.004)
    assert bright.projector[0][dark.projector[0]].all()
    rows, cols = np.nonzero(dark.projector[0])
    assert rows.min() + rows.max() == 299 and cols.min() + cols.max() == 399


def patch(level: float, around: float, sigma: float = 0.1) -> Photo:
    light = np.full((60, 80, 3), around)
    light[20:40, 30:50] = level
    return Photo(light, np.full(light.shape, sigma**2))


@pytest.mark.parametrize("change", [0.0, 0.004, -0.029, 0.029])
def test_an_iris_is_the_change_of_a_patch(change: float) -> None:
    found = iris_of(patch(100.0, 1.0), patch(100.0 * (1.0 + change), 100.0))
    assert found.change == pytest.approx(change, abs=1e-12)
    # Of 14 x 14 quads without edges, three colours, two photos.
    assert found.sigma == pytest.approx(0.1 * np.sqrt(2.0 / (14 * 14 * 3)) / 100.0)


@pytest.mark.parametrize(
    ("dark", "bright", "words"),
    [
        (patch(100.0, 1.0), patch(103.1, 100.0), r"changes by \+3\.1 %"),
        (patch(100.0, 1.0), patch(96.9, 100.0), r"changes by -3\.1 %"),
        (patch(100.0, 34.0), patch(100.0, 100.0), "no white patch"),
        (patch(100.0, 1.0, sigma=21.6), patch(100.0, 100.0), "no white patch"),
        (patch(100.0, 100.0), patch(100.0, 100.0), "no white patch"),
    ],
)
def test_a_patch_that_changes_or_is_not_seen_is_refused(
    dark: Photo, bright: Photo, words: str
) -> None:
    with pytest.raises(CalibrationError, match=words) as caught:
        iris_of(dark, bright)
    assert caught.value.device == "projector" and caught.value.hint


def test_a_patch_is_seen_where_it_has_three_times_the_light() -> None:
    assert iris_of(patch(100.0, 33.0), patch(100.0, 90.0)).change == 0.0
    assert iris_of(patch(100.0, 1.0, sigma=21.2), patch(100.0, 90.0)).change == 0.0


@pytest.mark.parametrize(
    ("change", "sigma", "good"),
    [(0.005, 0.0, True), (-0.0051, 0.0, False), (0.007, 0.001, True), (0.0071, 0.001, False)],
)
def test_an_iris_is_good_within_its_error(change: float, sigma: float, good: bool) -> None:
    (figure,) = Iris(change, sigma).figures()
    assert (figure.verdict is Verdict.GOOD) is good
    assert (figure.name, figure.value, figure.sigma) == ("light.iris", change, sigma)
    assert figure.limit == "within 0.005"
