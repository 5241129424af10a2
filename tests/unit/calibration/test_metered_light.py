"""The aperture and the refreshes of white light, before lamps of any strength."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.calibration.figures import Verdict
from pdcd.calibration.light.metering import (
    FULL_SHARE,
    MOST_WHITE_REFRESHES,
    OPEN_REFRESHES,
    WISHED,
    choose_wide_aperture,
    meter_light,
)
from pdcd.calibration.script import PhotoRequest
from pdcd.errors import CalibrationError
from tests.unit.calibration.scripted import STOPS, Answered, Run, run, session_of
from tests.unit.planning.test_measured import config


def lit(session: Answered, rate: float) -> Any:
    """A camera whose brightest sample gains `rate` of saturation a refresh at f/8, and clips."""
    full_dn = session.profile.saturation_dn(100)

    def taken(wanted: PhotoRequest) -> Any:
        both = (wanted.shown.projector_index == -2) & (wanted.shown.mask_index == -2)
        level = min(rate * int(both.sum()) * (8.0 / (wanted.f_number or 8.0)) ** 2, 1.0)
        planes = np.full((4, 20, 50), 0.5 * level * full_dn)
        planes[2] = level * full_dn  # the brightest plane counts
        planes[2, 0, 0] = 9.0 * full_dn  # but no hot pixel
        return SimpleNamespace(raw=SimpleNamespace(planes=planes), iso=wanted.iso)

    return taken


def metered(rate: float, **more: Any) -> tuple[Answered, Run]:
    session = session_of(**more)
    return session, run(meter_light(session), lit(session, rate))


@pytest.mark.parametrize("rate", [2e-5, 3e-4, 0.0027, 0.02, 0.2])
def test_white_light_fills_the_sensor_after_the_refreshes_that_are_wished(rate: float) -> None:
    session, found = metered(rate)
    assert session.f_number in STOPS and found.outcome is not None
    of_stop = {f: FULL_SHARE / (rate * (8.0 / f) ** 2) for f in STOPS}
    wanted = next((f for f in STOPS if of_stop[f] >= WISHED * (1 - 1e-6)), STOPS[-1])
    assert session.f_number == wanted
    assert session.full == pytest.approx(min(of_stop[wanted], MOST_WHITE_REFRESHES), abs=1.01)
    values = {figure.name: figure.value for figure in found.outcome.figures}
    assert values == {"full_refreshes": session.full, "f_number": session.f_number}


def test_the_mask_is_open_before_and_after_the_light_of_a_trial() -> None:
    session, found = metered(0.03)
    first = found.wanted[0]
    assert len(found.wanted) == 1
    assert (first.shown.mask_index == -2).all() and first.shown.refreshes == 12 + 2 * OPEN_REFRESHES
    white = np.flatnonzero(first.shown.projector_index == -2)
    assert (white[0], white[-1], white.size) == (OPEN_REFRESHES, OPEN_REFRESHES + 11, 12)
    assert session.full >= WISHED


def test_light_that_is_too_strong_for_the_lens_is_refused() -> None:
    with pytest.raises(CalibrationError, match="after 3 refreshes") as caught:
        metered(0.2, f_numbers=(8.0,))
    assert caught.value.device == "camera" and "close the lens" in str(caught.value.hint)


@pytest.mark.parametrize("f_numbers", [(8.0,), STOPS, ()])
def test_no_light_is_refused_after_the_widest_and_the_longest(f_numbers: tuple[float, ...]) -> None:
    session = session_of(f_numbers=f_numbers)
    with pytest.raises(CalibrationError, match=r"0\.00% of saturation") as caught:
        run(meter_light(session), lit(session, 0.0))
    assert caught.value.device == "camera" and "lens cap" in str(caught.value.hint)


def test_a_lens_that_is_fixed_or_not_set_from_here_stays() -> None:
    fixed = config(camera={"f_number": 5.6})
    session = session_of(fixed)
    found = run(meter_light(session), lit(session, 0.001))
    assert {wanted.f_number for wanted in found.wanted} == {5.6} == {session.f_number}
    manual, found = metered(0.002, f_numbers=())
    assert {wanted.f_number for wanted in found.wanted} == {None}
    assert manual.f_number is None and manual.full == pytest.approx(FULL_SHARE / 0.002, abs=1)
    assert found.outcome is not None and len(found.outcome.figures) == 1


def test_short_photos_may_have_a_wider_lens() -> None:
    session = session_of(f_numbers=(2.0, 4.0, 5.6, 8.0, 11.0))
    session.f_number, session.full = 8.0, 240
    for least, found in ((60, (4.0, 60)), (61, (5.6, int(240 * 0.7**2))), (200, (8.0, 240))):
        assert choose_wide_aperture(session, least) == found
    session.f_number = None
    assert choose_wide_aperture(session, 60) == (None, 240)
    fixed = session_of(config(camera={"f_number": 8.0}), f_numbers=(4.0, 8.0))
    fixed.f_number, fixed.full = 8.0, 240
    assert choose_wide_aperture(fixed, 60) == (8.0, 240)


def test_more_refreshes_than_all_steps_take_are_doubtful() -> None:
    session, found = metered(FULL_SHARE / 1300.0, f_numbers=(8.0,))
    assert session.full == MOST_WHITE_REFRESHES and found.outcome is not None
    assert found.outcome.verdict is Verdict.DOUBTFUL
    session, found = metered(FULL_SHARE / 1100.0, f_numbers=(8.0,))
    assert found.outcome is not None and found.outcome.verdict is Verdict.GOOD
    assert session.full == pytest.approx(1100, abs=1)
