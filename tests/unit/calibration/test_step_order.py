"""Steps by their names, and the order in which they are run."""

from __future__ import annotations

from pdcd.calibration.script import PhotoRequest
from pdcd.calibration.steps import AT_WISH, METER, STEP_SCRIPTS, order_steps, start_step_script
from tests.unit.calibration.scripted import session_of


def test_all_steps_but_those_at_wish_are_run_in_their_order() -> None:
    whole = ("sensor", "light", "geometry", "timing", "shutter", "registration", "check")
    assert order_steps(()) == whole
    assert set(STEP_SCRIPTS) - set(whole) == AT_WISH == {"response", "focus", "disparity"}
    assert order_steps((), "scene") == ("geometry",)
    assert order_steps(("shutter", "sensor"), "scene") == ("sensor", "shutter")
    assert order_steps(("check", "focus", "sensor")) == ("sensor", "focus", "check")
    assert order_steps(("response",)) == ("response",)


def test_metering_comes_first_and_wants_white_light() -> None:
    first = next(start_step_script(METER, session_of()))
    assert isinstance(first, PhotoRequest) and first.shown.name == "meter-1"
    assert METER not in STEP_SCRIPTS
