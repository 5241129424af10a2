"""Steps of a stopped calibration that the next one takes over; what a new outcome makes stale."""

from __future__ import annotations

import errno
import os
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import msgspec
import pytest

from pdcd.bench.calibration import PROFILE, MeasuredValue
from pdcd.calibration.steps import GOES_BY, STALE, STEP_SCRIPTS
from pdcd.capture.keeping import (
    CalibrationKeeper,
    PreviousCalibration,
    find_reusable_steps,
    measure_age_h,
)
from pdcd.cli.calibrate import ACTIONS
from pdcd.errors import NoSpaceError
from pdcd.protocol.request import CalibrateRequest
from pdcd.words import StepName
from tests.unit.bench._calibrations import entry, record
from tests.unit.bench.test_choosing import step

NOW = datetime(2026, 1, 1, 12, 0, tzinfo=UTC)
NAMES = ("sensor", "light", "geometry", "timing", "shutter", "registration", "check")


def stopped(*steps: str, **changed: Any) -> PreviousCalibration:
    told = record(steps=tuple(map(step, ("meter", *steps))), state="failed", **changed)
    return PreviousCalibration(Path("/cals/a1"), told, "0" * 64)


def over(before: PreviousCalibration | None, **asked: Any) -> list[str]:
    return list(find_reusable_steps(before, CalibrateRequest(**asked), NAMES, NOW))


def test_a_calibration_goes_on_where_the_same_one_stopped() -> None:
    before = stopped("sensor", "light", "geometry")
    assert over(before) == ["sensor", "light", "geometry"]
    assert over(before, anew=True) == over(before, steps=("timing",)) == []
    assert over(before, subject="scene") == over(before, marks="xor") == over(None) == []
    for changed in ({"asked": ("geometry",)}, {"state": "done"}, {"state": None}):
        told = msgspec.structs.replace(before.record, **changed)
        assert over(PreviousCalibration(before.folder, told, "")) == []
    # One that was killed, and one that had gone on itself.
    running = msgspec.structs.replace(
        before.record, state="running", taken_over={"timing": "2026-01-01T10:00:00Z"}
    )
    assert over(PreviousCalibration(before.folder, running, "")) == [
        "sensor",
        "light",
        "geometry",
        "timing",
    ]


def test_what_is_old_or_bad_is_measured_again_with_all_that_goes_by_it() -> None:
    before = stopped(
        "sensor", "light", "geometry", "timing", "shutter", left_out={"geometry": "bad"}
    )
    assert over(before) == ["sensor", "light"]
    old = tuple(
        msgspec.structs.replace(each, made_utc="2025-12-31T23:00:00Z")
        if each.name == "sensor" else each
        for each in before.record.steps
    )  # fmt: skip
    told = msgspec.structs.replace(before.record, steps=old, left_out={})
    assert over(PreviousCalibration(before.folder, told, "")) == ["geometry", "timing", "shutter"]
    # All was found, and then it was killed: there is nothing to go on with.
    assert over(stopped(*NAMES)) == []


@pytest.mark.parametrize(
    ("made", "hours"),
    [("2026-01-01T09:30:00Z", 2.5), ("2026-01-02T00:00:00Z", float("inf")),
     ("some day", float("inf")), ("2026-01-01", float("inf"))],
)  # fmt: skip
def test_the_age_of_a_step(made: str, hours: float) -> None:
    assert measure_age_h(made, NOW) == hours


def keeper_of(folder: Path, before: Path, told: Any) -> CalibrationKeeper:
    given: Any = dict.fromkeys(
        ("config", "typed", "rig", "profile", "camera", "job", "request", "taken_over", "write")
    )
    run: Any = SimpleNamespace(path=folder, where=folder)
    previous = PreviousCalibration(before, told, "0" * 64)
    return CalibrationKeeper(folder=run, before=previous, **given)


def test_a_new_outcome_makes_values_of_other_steps_untrue(tmp_path: Path) -> None:
    said = {"rig.misregistration_px": "registration", "mask.blur_px": "registration",
            "mask.skew_s": "timing", "camera.responsivity_e": "light"}  # fmt: skip
    measured = {key: msgspec.structs.replace(entry(1.0), step=by) for key, by in said.items()}
    keeper = keeper_of(tmp_path, tmp_path, record(measured=measured))
    keeper.steps = [step("meter"), step("geometry")]
    found: dict[str, MeasuredValue] = {}
    keeper._carry_over(found, tmp_path)
    assert found.keys() == said.keys() - {"rig.misregistration_px"}
    assert "pdcd calibrate registration" in keeper.stale["rig.misregistration_px"]
    # Not where it was measured again after that, nor where the geometry is bad itself.
    found = {"rig.misregistration_px": entry(2.0)}
    keeper._carry_over(found, tmp_path)
    assert found.keys() == said.keys() and not keeper.stale
    keeper.left_out, found = {"geometry": "bad"}, {}
    keeper._carry_over(found, tmp_path)
    assert found.keys() == said.keys() and not keeper.stale


@pytest.mark.parametrize("full", [False, True])
def test_a_profile_is_taken_over_or_the_disk_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full: bool
) -> None:
    own, before = tmp_path / "own.partial", tmp_path / "before"
    own.mkdir()
    before.mkdir()
    (before / PROFILE).write_text("full_well_e = 1.0\n")
    profile = MeasuredValue(value="sensor.toml", step="body", made_utc="2026-01-01T00:00:00+00:00")
    keeper = keeper_of(own, before, record(measured={"camera.profile": profile}))
    measured: dict[str, MeasuredValue] = {}
    if full:

        def refuse(path: Path, data: bytes) -> int:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(Path, "write_bytes", refuse)
        with pytest.raises(NoSpaceError) as told:
            keeper._carry_over(measured, own)
        assert told.value.device == str(own)
        return
    keeper._carry_over(measured, own)
    assert measured["camera.profile"].folder == str(before)
    assert (own / PROFILE).read_bytes() == (before / PROFILE).read_bytes()


def test_the_tables_name_steps_and_nobody_calls_a_step_like_an_action() -> None:
    names = set(get_args(StepName))
    assert names == set(STEP_SCRIPTS) and GOES_BY.keys() | STALE.keys() <= names
    assert all(needed <= names for needed in GOES_BY.values())
    order = list(STEP_SCRIPTS)
    for name, needed in GOES_BY.items():  # what a step goes by comes before it
        assert all(order.index(each) < order.index(name) for each in needed)
    assert not names & set(ACTIONS)
