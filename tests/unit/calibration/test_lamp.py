"""Lamps that drift and flicker, by numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.calibration.figures import Verdict
from pdcd.calibration.light.lamp import Lamp, measure_lamp
from pdcd.errors import CalibrationError

TIMES = np.array([0.0, 10.0, 20.0, 30.0, 40.0])
ZIGZAG = np.array([1.0, -2.0, 2.0, -2.0, 1.0])
"""Neither a mean nor a slope."""


def test_drift_is_the_slope_and_flicker_what_is_left() -> None:
    levels = 500.0 * (1.0 + 1e-4 * (TIMES - 20.0) + 1e-3 * ZIGZAG)
    found = measure_lamp(TIMES + 7.0, levels, noise=5e-4)
    middle = float(np.median(levels)) / 500.0
    assert found.drift_per_h == pytest.approx(0.36 / middle)
    spread = 14e-6 / 3.0 / middle**2
    assert found.flicker == pytest.approx(np.sqrt(spread - 25e-8))
    assert found.flicker_sigma == pytest.approx(np.sqrt(spread / 6.0))
    assert found.drift_sigma == pytest.approx(3600.0 * np.sqrt(spread / 1000.0))
    assert found.seconds == 40.0
    quiet = measure_lamp(TIMES, levels, noise=0.01)
    assert quiet.flicker == 0.0
    assert quiet.drift_sigma == pytest.approx(3600.0 * 0.01 / np.sqrt(1000.0))


@pytest.mark.parametrize(
    ("times", "levels", "words", "device"),
    [
        (TIMES[:4], np.ones(4), "4 photos are too few", "projector"),
        (np.full(5, 3.0), np.ones(5), "5 photos are too few", "projector"),
        (TIMES, np.array([1.0, 1.0, 1.0, 1.0, 0.2]), "photo 5 of the series is dark", "shutter"),
        (TIMES, 1.0 + 0.02 * ZIGZAG, "flickers by 4", "projector"),
        (TIMES, 1.0 - 0.3 / 40.0 * (TIMES - 20.0), "changed by -30 % in 40 s", "projector"),
    ],
)
def test_a_lamp_that_is_no_constant_light_is_refused(
    times: np.ndarray, levels: np.ndarray, words: str, device: str
) -> None:
    with pytest.raises(CalibrationError, match=words) as caught:
        measure_lamp(times, levels)
    assert caught.value.device == device and caught.value.hint


@pytest.mark.parametrize(
    ("drift", "sigma", "flicker", "good"),
    [(-0.05, 0.001, 0.02, (False, False)), (0.05, 0.02, 0.001, (True, True))],
)
def test_a_drift_is_doubtful_where_it_is_sure(
    drift: float, sigma: float, flicker: float, good: tuple[bool, bool]
) -> None:
    figures = Lamp(drift, sigma, flicker, 1e-4, 40.0).figures()
    assert tuple(f.verdict is Verdict.GOOD for f in figures) == good
