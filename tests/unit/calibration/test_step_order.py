"""Steps by their names, and the order in which they are run."""

from __future__ import annotations

from collections.abc import Generator

import pytest

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


@pytest.mark.parametrize("name", [METER, *STEP_SCRIPTS])
def test_each_name_has_a_script(name: str) -> None:
    script = start_step_script(name, session_of())
    assert isinstance(script, Generator)
    script.close()


def test_metering_comes_first_and_wants_white_light() -> None:
    first = next(start_step_script(METER, session_of()))
    assert isinstance(first, PhotoRequest) and first.shown.name == "meter-1"
    assert METER not in STEP_SCRIPTS


def test_a_name_that_is_no_step_is_told() -> None:
    with pytest.raises(KeyError, match="nothing"):
        start_step_script("nothing", session_of())
