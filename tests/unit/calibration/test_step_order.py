"""Steps by their names, and the order in which they are run."""

from __future__ import annotations

from collections.abc import Generator

import pytest

from pdcd.calibration.script import Wanted
from pdcd.calibration.steps import AT_WISH, METER, STEPS, ordered, script_of
from tests.unit.calibration.scripted import session_of


def test_all_steps_but_those_at_wish_are_run_in_their_order() -> None:
    whole = ("sensor", "light", "geometry", "timing", "shutter", "registration", "check")
    assert ordered(()) == whole
    assert set(STEPS) - set(whole) == AT_WISH == {"response", "focus", "disparity"}
    assert ordered((), "scene") == ("geometry",)
    assert ordered(("shutter", "sensor"), "scene") == ("sensor", "shutter")
    assert ordered(("check", "focus", "sensor")) == ("sensor", "focus", "check")
    assert ordered(("response",)) == ("response",)


@pytest.mark.parametrize("name", [METER, *STEPS])
def test_each_name_has_a_script(name: str) -> None:
    script = script_of(name, session_of())
    assert isinstance(script, Generator)
    script.close()


def test_metering_comes_first_and_wants_white_light() -> None:
    first = next(script_of(METER, session_of()))
    assert isinstance(first, Wanted) and first.shown.name == "meter-1"
    assert METER not in STEPS


def test_a_name_that_is_no_step_is_told() -> None:
    with pytest.raises(KeyError, match="nothing"):
        script_of("nothing", session_of())
