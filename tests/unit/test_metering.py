"""The aperture from test exposures."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.metering import TARGET, next_aperture, peak_share

STOPS = tuple(2.0 ** (k / 6.0) for k in range(49))


@pytest.mark.parametrize("light", [1e-3, 0.1, 1.0, 30.0, 3e3])
def test_settles_just_below_the_target(light: float) -> None:
    """`light`: share of saturation at f/1 in the test; the real exposure has ten times more."""
    f_number, settled, tests = 8.0, False, 0
    while not settled:
        peak = min(light / f_number**2, 1.0)
        f_number, settled = next_aperture(STOPS, f_number, peak, 10.0)
        tests += 1
    final = 10.0 * light / f_number**2
    assert tests <= 6
    assert final <= TARGET * (1 + 1e-9)
    assert final >= TARGET / 2 ** (1 / 3) * (1 - 1e-9) or f_number == 1.0


def test_no_light_opens_the_lens_and_no_stop_is_dark_enough_closes_it() -> None:
    f_number, settled = 8.0, False
    while not settled:
        f_number, settled = next_aperture(STOPS, f_number, 0.0, 1.0)
    assert f_number == 1.0
    assert next_aperture(STOPS, max(STOPS), 1.0, 1.0) == (max(STOPS), True)


def test_peak_share() -> None:
    planes = np.array([[[10.0]], [[40.0]], [[-3.0]], [[20.0]]], dtype=np.float32)
    assert peak_share(planes, np.array([[False]]), 80.0) == 0.5
    assert peak_share(planes, np.array([[True]]), 80.0) == 1.0
