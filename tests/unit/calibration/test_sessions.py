"""What a session knows, and how it goes on by what steps found."""

from __future__ import annotations

from collections.abc import Generator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.calibration.script import ConfigValue, StepOutcome
from pdcd.calibration.shown import make_still_sequence
from pdcd.calibration.steps import METER, STEP_SCRIPTS, order_steps, start_step_script
from pdcd.errors import CalibrationError
from pdcd.panels.frames import BLACK, WHITE
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from tests.unit.calibration.scripted import session_of
from tests.unit.planning.test_measured import config


def test_a_session_goes_on_by_what_a_step_found() -> None:
    session = session_of()
    before = session.profile
    map_ = Map.filling((1600, 1200))
    words = {"mask.skew_s": ConfigValue(0.002, 1e-4), "camera.profile": ConfigValue("own.toml")}
    session.learn("timing", StepOutcome(words=words, maps={"mask": map_}, arrays={"a": np.ones(2)}))
    assert session.config.mask.skew_s == 0.002
    assert session.config.camera.profile != "own.toml"
    assert session.found("mask").size_px == (1600, 1200)
    assert session.done == ["timing"] and session.arrays["a"].tolist() == [1.0, 1.0]
    assert session.profile is before
    other: Any = SimpleNamespace()
    session.learn("sensor", StepOutcome(profile=other, arrays={"b": np.zeros(1)}))
    assert session.profile is other and session.done == ["timing", "sensor"]
    assert set(session.arrays) == {"a", "b"}


def test_what_the_display_does_not_know_yet_is_sent_by_the_photo() -> None:
    """A delay that was measured holds from the display's next start on."""
    session = session_of()
    shown = make_still_sequence("white", 5, WHITE, WHITE)
    assert session.in_step(shown) is shown
    words = {"display.mask_delay_refreshes": ConfigValue(session.config.mask_delay_rows - 2)}
    session.learn("timing", StepOutcome(words=words))
    sent = session.in_step(shown)
    assert sent.mask_index.tolist() == [WHITE] * 5 + [BLACK] * 2
    assert sent.projector_index.tolist() == [BLACK] * 2 + [WHITE] * 5


@pytest.mark.parametrize("device", ["projector", "mask", "camera"])
def test_where_a_device_lies_must_have_been_measured(device: str) -> None:
    with pytest.raises(CalibrationError, match=f"where the {device} lies has not been") as caught:
        session_of().found(device)
    assert caught.value.device == device and "geometry" in str(caught.value.hint)
    named = session_of(config(mask={"place": Placing(turn_deg=1.0)}))
    with pytest.raises(CalibrationError):
        named.found("mask")


def test_all_steps_but_those_at_wish_are_run_in_their_order() -> None:
    whole = ("sensor", "light", "geometry", "timing", "shutter", "registration", "check")
    assert order_steps(()) == whole
    assert order_steps((), "scene") == ("geometry",)
    assert order_steps(("shutter", "sensor"), "scene") == ("sensor", "shutter")
    assert order_steps(("check", "focus", "sensor")) == ("sensor", "focus", "check")


@pytest.mark.parametrize("name", [METER, *STEP_SCRIPTS])
def test_each_name_has_a_script(name: str) -> None:
    script = start_step_script(name, session_of())
    assert isinstance(script, Generator)
    script.close()
