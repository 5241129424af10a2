"""Lines of signal over counted refreshes, of sensors that are made by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.sensor.dose import DoseLine, fit_dose_line
from pdcd.errors import CalibrationError

Floats = NDArray[np.float64]

DOSES = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 48.0, 64.0])
SLOPE, OFFSET = 100.0, 0.2
STRAIGHT = SLOPE * (DOSES + OFFSET)


def line(
    plane: str, doses: Floats, signal: Floats, noise_dn: float = 9.0, base_dn: float = 0.0
) -> DoseLine:
    return fit_dose_line(plane, doses, signal, float(signal[-1]) + base_dn, base_dn, noise_dn)


def test_a_straight_line_is_found_as_it_is() -> None:
    found = line("red", DOSES, STRAIGHT, base_dn=3.0)
    assert found.offset_refreshes == pytest.approx(OFFSET)
    assert found.error == pytest.approx(0.0, abs=1e-12)
    assert found.offset_sigma == pytest.approx(0.0, abs=1e-9)
    assert (found.saturation_dn, found.clipped) == (None, False)
    assert found.highest_dn == pytest.approx(SLOPE * 64.2 + 3.0)
    # Below 5 % of the highest signal nothing is told.
    low = 0.05 * STRAIGHT.max() / 0.95
    assert np.array_equal(np.isnan(found.deviations), low > STRAIGHT)


@pytest.mark.parametrize(
    ("share", "noise", "saturates", "clipped"),
    [(0.9, 9.0, True, False), (0.9, 0.5, True, True), (0.97, 0.1, False, False)],
)
def test_a_signal_that_stops_is_saturated(
    share: float, noise: float, saturates: bool, clipped: bool
) -> None:
    """Of the light that is due of 64 refreshes."""
    level = share * SLOPE * 64.0
    found = line("red", DOSES, np.append(SLOPE * DOSES[:-1], level), noise, 11.0)
    assert found.saturation_dn == (pytest.approx(level + 11.0) if saturates else None)
    assert found.clipped is clipped
    assert found.highest_dn == pytest.approx(level + 11.0)


def test_doses_near_the_end_of_the_sensor_are_left_out() -> None:
    """Where the signal bends, 95 % of its end is the end of the line; else all there is."""
    stopped = np.minimum(STRAIGHT, 5000.0)
    found = line("red", DOSES, stopped)
    told = ~np.isnan(found.deviations)
    assert told.tolist() == [(0.05 * 5000.0 <= s <= 0.95 * 5000.0) for s in stopped]
    assert found.offset_refreshes == pytest.approx(OFFSET) and found.saturation_dn == 5000.0
    assert not np.isnan(line("red", DOSES, STRAIGHT).deviations[-1])
    # 2 % less than what is due bends the line's end, but is no saturation.
    bent = line("red", DOSES, np.append(SLOPE * DOSES[:-1], 0.98 * SLOPE * 64.0))
    assert bent.saturation_dn is None and np.isnan(bent.deviations[-1])


def test_too_few_doses_in_range_are_refused() -> None:
    with pytest.raises(CalibrationError, match=r"plane blue: only \d doses lie where") as caught:
        line("blue", DOSES[-3:], STRAIGHT[-3:])
    assert caught.value.device == "camera" and "half of saturation" in str(caught.value.hint)
    four = np.array([8.0, 16.0, 24.0, 64.0])
    assert line("red", four, SLOPE * four).error == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(CalibrationError, match="only 3 doses"):
        line("red", four[1:], SLOPE * four[1:])
    same = np.array([8.0, 8.0, 40.0, 48.0, 64.0])
    with pytest.raises(CalibrationError, match="only 2 doses"):
        line("red", same, SLOPE * same)


@pytest.mark.parametrize("at", range(8))
@pytest.mark.parametrize("share", [0.0, 0.1, 0.19, 0.4])
def test_a_photo_without_its_light_is_the_shutter_s(share: float, at: int) -> None:
    """Whichever it is: one of a large dose pulls down the slope that it is judged by."""
    signal = STRAIGHT.copy()
    signal[at] *= share
    if at == 0 and share > 0.15:
        line("red", DOSES, signal)  # below 5 % of the sensor's range
        return
    with pytest.raises(
        CalibrationError, match=rf"red: the photo of {DOSES[at]:.0f} refreshes lacks light"
    ) as found:
        line("red", DOSES, signal)
    assert found.value.device == "shutter" and "cable" in str(found.value.hint)
