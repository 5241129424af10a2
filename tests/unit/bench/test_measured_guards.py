"""Guards of a bench whose panels' times were measured."""

from __future__ import annotations

import pytest

from pdcd.bench.measured import TIME_KEYS, with_guards
from pdcd.bench.tables import CalibrationConfig, Config, ScheduleConfig
from pdcd.words import GuardsName


def test_measured_times_make_the_schedule_go_by_the_lag() -> None:
    assert with_guards(Config(), TIME_KEYS).schedule.guards == "auto"
    assert with_guards(Config(), TIME_KEYS[1:]).schedule.guards is True
    assert with_guards(Config(), ()) == Config()


@pytest.mark.parametrize("guards", [False, "full", "both", "auto"])
def test_what_was_typed_otherwise_stays(guards: bool | GuardsName) -> None:
    typed = Config(schedule=ScheduleConfig(guards=guards))
    assert with_guards(typed, TIME_KEYS) == typed


def test_guards_may_be_kept() -> None:
    config = Config(calibration=CalibrationConfig(keep=("schedule.guards",)))
    assert with_guards(config, TIME_KEYS) == config
