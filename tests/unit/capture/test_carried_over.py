"""What a calibration takes over from the one before it."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.bench import calibration as kept
from pdcd.bench.calibration import MeasuredValue
from pdcd.capture.keeping import CalibrationKeeper, PreviousCalibration
from pdcd.errors import NoSpaceError


@pytest.mark.parametrize("full", [False, True])
def test_a_profile_is_taken_over_or_the_disk_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full: bool
) -> None:
    own, before = tmp_path / "own.partial", tmp_path / "before"
    own.mkdir()
    before.mkdir()
    (before / kept.PROFILE).write_text("full_well_e = 1.0\n")
    entry = MeasuredValue(value="sensor.toml", step="body", made_utc="2026-01-01T00:00:00+00:00")
    record: Any = SimpleNamespace(measured={"camera.profile": entry})
    given: Any = dict.fromkeys(
        ("config", "typed", "rig", "profile", "camera", "job", "request", "taken_over", "write")
    )
    folder: Any = SimpleNamespace(path=own, where=own)
    keeper = CalibrationKeeper(
        folder=folder, before=PreviousCalibration(before, record, "0" * 64), **given
    )
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
    assert (own / kept.PROFILE).read_bytes() == (before / kept.PROFILE).read_bytes()
