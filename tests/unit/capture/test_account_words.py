"""What is said of a job when it has ended: figures and warnings, each from its source."""

from __future__ import annotations

import math
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.bench.stops import AbsoluteScale
from pdcd.capture.job import (
    MAX_NAMED,
    TOLD,
    describe_shots_taken,
    list_run_warnings,
    make_failure,
    merge_warnings,
    summarise_run,
)
from pdcd.errors import Cancelled, DiskError, ExposureError, PdcdError

NAMES = tuple("abcdefghij")


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        ((), "3 of 5 shots"),
        (NAMES[:1], "3 of 5 shots, missing: a"),
        (NAMES[:8], "3 of 5 shots, missing: a, b, c, d, e, f, g, h"),
        (NAMES[:9], "3 of 5 shots, missing: a, b, c, d, e, f, g, h and 1 more"),
        (NAMES, "3 of 5 shots, missing: a, b, c, d, e, f, g, h and 2 more"),
    ],
)
def test_how_far_a_run_came_is_told_with_the_first_names(
    missing: tuple[str, ...], words: str
) -> None:
    assert describe_shots_taken(3, 5, missing) == words and MAX_NAMED == 8


def test_what_is_said_of_many_shots_is_said_once() -> None:
    assert merge_warnings([]) == ()
    assert merge_warnings(["shot a: late", "x", "shot b: late", "shot c: late"]) == (
        "shot a: late (and so of 2 more)", "x",
    )  # fmt: skip
    assert merge_warnings(["shot a: ", "shot b: "]) == ("shot a: ", "shot b: ")
    assert merge_warnings(["same", "same"]) == ("same (and so of 1 more)",)


@pytest.mark.parametrize("count", [TOLD - 1, TOLD, TOLD + 1, TOLD + 9])
def test_a_result_has_so_many_warnings_and_the_last_says_how_many_more(count: int) -> None:
    texts = [f"text {number}" for number in range(count)]
    brief = merge_warnings(texts)
    if count <= TOLD == 64:
        assert brief == tuple(texts)
    else:
        assert len(brief) == TOLD and brief[:-1] == tuple(texts[: TOLD - 1])
        assert brief[-1] == f"and {count - 63} more; capture.json has all of them"


@pytest.mark.parametrize("mock", [True, False])
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("estimated", [True, False])
def test_what_the_user_must_know_of_a_finished_run(
    mock: bool, known: bool, estimated: bool
) -> None:
    exif = {"a": {}, "b": {"doubts": ["black is odd"]}, "c": {"doubts": ["black is odder"]}}
    developed: Any = SimpleNamespace(
        saturated={"a": 0, "b": 3}, warnings=("dim",), blind=0.0, exif=exif, dead=0
    )
    config: Any = SimpleNamespace(camera=SimpleNamespace(responsivity_e=(1.0,) if known else None))
    profile: Any = SimpleNamespace(estimated=estimated, name="eos")
    found = list(list_run_warnings(developed, config, profile, mock=mock))
    assert found[:3] == ["shot b: 3 pixels are saturated", "dim", "shot b: black is odd"]
    rest = found[3:]
    assert any("camera.responsivity_e is not set" in text for text in rest) is (
        not known and not mock
    )
    assert ("sensor profile eos is an estimate" in rest) is estimated
    assert len(rest) == (not known and not mock) + estimated
    developed.dead = 7
    (more,) = set(list_run_warnings(developed, config, profile, mock=mock)) - set(found)
    assert more.startswith("7 pixels of the camera stay dark beside lit ones")


def shot(open_ns: int, close_ns: int, refreshes: int, missed: int) -> Any:
    return SimpleNamespace(
        open_ns=open_ns, close_ns=close_ns, open_s=(close_ns - open_ns) * 1e-9,
        refreshes=refreshes, missed=missed,
    )  # fmt: skip


def developed(**said: Any) -> Any:
    shots = (
        shot(0, 2_000_000_000, 120, 1),
        shot(0, 2_000_000_000, 120, 1),  # the second bucket of the same exposure
        shot(3_000_000_000, 3_500_000_000, 30, 2),
    )
    how = SimpleNamespace(method="coded", coded=16, parts=4, pilot=5, repeat=2)
    scale = AbsoluteScale("as of the calibration of 2026-01-01", 0.03)
    goal = SimpleNamespace(name="indirect")
    record = SimpleNamespace(how=how, shots=shots, goal=goal, scale=scale)
    fields = {
        "record": record, "parts": 3, "rms_sigma": 0.02, "sigma_kind": "measured",
        "sigma_mean": 0.5, "rms_errors": (0.03, 0.01), "quality": "q", "picture": "indirect",
        "transport": {"transport_photos": 7}, "exif": {"a": {"iso": 1}}, "deviations": {"a": {}},
        "decided": (), "blind": 0.0,
    }  # fmt: skip
    return SimpleNamespace(**{**fields, **said})


def test_a_finished_run_in_figures() -> None:
    plan: Any = SimpleNamespace(
        family="hadamard", passes=6, prediction=SimpleNamespace(error=0.04)
    )  # fmt: skip
    assert summarise_run(plan, developed()) == {
        "goal": "indirect", "picture": "indirect", "method": "coded", "family": "hadamard",
        "codes": 16 * 3 // 4 + 5, "parts": 3, "pilot": 5, "passes": 6, "repeat": 2, "shots": 3,
        "refreshes": 150, "exposure_s": 2.5, "missed_refreshes": 3, "rms_sigma": 0.02,
        "sigma_kind": "measured", "rms_error_quads": 0.03, "rms_error_cells": 0.01,
        "sigma_mean": 0.5, "predicted_error": 0.04, "scale_sigma": 0.03,
        "scale": "as of the calibration of 2026-01-01",
        "quality": "q", "transport_photos": 7,
    }  # fmt: skip
    plan.prediction = None
    bare = summarise_run(plan, developed(parts=0, rms_sigma=math.inf))
    assert (bare["codes"], bare["parts"]) == (16 // 4 + 5, 1)
    assert bare["rms_sigma"] is None and bare["predicted_error"] is None
    assert summarise_run(plan, developed(decided=("a", "b")))["decided"] == "a; b"
    assert summarise_run(plan, developed(blind=0.125))["blind_share"] == 0.125


class Folder:
    """A run folder that notes its log, or fails to."""

    def __init__(self, where: Path | None, error: Exception | None = None) -> None:
        self.where, self.error = where, error
        self.path = Path("/proc/self/fd/7")
        self.lines: list[Any] = []

    def log(self, line: Any) -> None:
        if self.error is not None:
            raise self.error
        self.lines.append(line)

    def files(self) -> tuple[str, ...]:
        return ("log.jsonl",)


def failed(folder: Folder | None, error: PdcdError, **more: Any) -> Any:
    made: Any = folder
    return make_failure("job", made, 99, error, safe=False, **more)


def test_a_job_that_failed_says_why_and_what_it_has() -> None:
    folder = Folder(Path("/runs/job.partial"))
    error = ExposureError("no light in /proc/self/fd/7/raw", device="/proc/self/fd/7", hint="look")
    found = failed(folder, error, taken="1 of 3 shots", warnings=["w", "w"])
    fields = {
        "kind": "exposure", "message": "no light in /runs/job.partial/raw",
        "device": "/runs/job.partial", "hint": "look",
    }  # fmt: skip
    assert folder.lines == [
        {"t_mono_ns": 99, "event": "failed", **fields, "safe": False, "taken": "1 of 3 shots"}
    ]
    assert (found.job, found.state, found.folder) == ("job", "failed", "/runs/job.partial")
    assert found.error == fields and found.files == ("log.jsonl",)
    assert found.summary == {"taken": "1 of 3 shots"}
    assert found.warnings == ("w (and so of 1 more)",)


def test_no_error_names_the_folder_by_a_descriptor_of_this_process() -> None:
    """Also where the work process had it, which knows this one by its number."""
    folder = Folder(Path("/runs/job.partial"))
    own = f"/proc/{os.getpid()}/fd/7"
    error = DiskError(f"no room in {own}, {own}1 and /proc/1/fd/7", device=f"{own}/linear/a.tif")
    found = failed(folder, error)
    assert found.error["device"] == "/runs/job.partial/linear/a.tif"
    assert found.error["message"] == f"no room in /runs/job.partial, {own}1 and /proc/1/fd/7"


def test_a_job_that_was_cancelled_and_one_without_a_folder() -> None:
    folder = Folder(Path("/runs/job.partial"))
    found = failed(folder, Cancelled("by ada"))
    assert found.state == folder.lines[0]["event"] == "cancelled"
    assert "taken" not in folder.lines[0] and found.error["device"] is None
    assert found.summary == {} and found.warnings == ()
    gone = Folder(None)
    assert failed(gone, Cancelled("by ada")).folder is None and gone.lines == []
    none = failed(None, ExposureError("dark"))
    assert (none.state, none.folder, none.files) == ("failed", None, ())


def test_a_log_that_cannot_be_written_does_not_hide_what_went_wrong() -> None:
    where = Path("/runs/job.partial")
    found = failed(Folder(where, DiskError("full")), ExposureError("dark"))
    assert found.error["message"] == "dark" and found.folder == str(where)
    with pytest.raises(ZeroDivisionError):  # a fault of the program is another matter
        failed(Folder(where, ZeroDivisionError()), ExposureError("dark"))
