"""When all photos of a run are there: they are looked at again, and a full disk loses none."""

from __future__ import annotations

import errno
import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

import pytest

from pdcd.capture.engine import Engine
from pdcd.errors import ExposureError, NoSpaceError
from pdcd.files import put
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import RunFolder, read_manifest

WHITE = CaptureRequest(goal="white", codes=4)


def captured(engine: Engine, job: str) -> CaptureResult:
    return engine.capture(WHITE, job=job, emit=lambda _: None, cancelled=lambda: False)


def test_the_photos_of_a_run_are_looked_at_again_before_it_is_whole(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Collection[str]] = []
    monkeypatch.setattr(engine._rig.readout, "recheck", asked.append, raising=False)
    for job in ("one", "two"):
        result = captured(engine, job)
        shots = read_manifest(Path(str(result.folder))).run.shots
        assert {shot.sha256 for shot in shots} <= set(asked[-1])
    assert len(asked) == 2 and not set(asked[0]) & set(asked[1])


def test_a_photo_that_changed_since_spoils_what_rests_on_it(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(photos: Collection[str]) -> None:
        raise ExposureError("changed after it was taken", device="camera")

    monkeypatch.setattr(engine._rig.readout, "recheck", refuse, raising=False)
    result = captured(engine, "job")
    assert result.state == "failed" and str(result.folder).endswith(".partial")
    request = CalibrateRequest(steps=("timing",), subject="scene")
    stopped = engine.calibrate(
        request, job="calibration", emit=lambda _: None, cancelled=lambda: False
    )
    assert (stopped.error or {})["message"] == "changed after it was taken"


def test_a_disk_that_is_full_after_the_last_photo_loses_none(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise NoSpaceError("the disk is full", hint="free some space and run again")

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "hashes", refuse)
        result = captured(engine, "job")
    error = result.error or {}
    assert error["kind"] == "no_space" and error["message"] == "the disk is full"
    assert error["hint"] == (
        f"all RAW files are safe: free some space and run pdcd decode --partial {result.folder}"
    )


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_a_report_that_the_disk_does_not_take_costs_the_page_and_one_line(
    engine: Engine,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    number: int,
) -> None:
    """And no traceback: that is for faults of the program."""

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(put, "write_atomic", refuse)
    result = engine.capture(
        WHITE, job="job", emit=lambda _: None, cancelled=lambda: False, report=True
    )
    (line,) = [record for record in caplog.records if "no report was made" in record.getMessage()]
    assert result.state == "done" and not line.exc_info
