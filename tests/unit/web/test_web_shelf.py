"""Runs on disk as the page sees them: by name, and nothing but pictures and reports."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from pdcd.errors import RequestError
from pdcd.web.shelf import MOST_PICTURE_BYTES, RunShelf

JOB, OTHER = "20260101T120301Z-7f3a", "20260101T120302Z-0001"


def run(state: Path, job: str, place: str = "captures") -> Path:
    folder = state / place / job
    (folder / "preview").mkdir(parents=True)
    told = {
        "job": job, "schema": 1, "state": "done", "request": {"goal": "indirect"},
        "owner": {"user": "anna"},
        "started_utc": "2026-01-01T12:03:01Z",
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(told))
    for name in ("white", "indirect", "direct"):
        (folder / "preview" / f"{name}.png").write_bytes(name.encode())
    return folder


def test_the_picture_of_the_goal_comes_first(tmp_path: Path) -> None:
    run(tmp_path, JOB)
    shelf = RunShelf(tmp_path)
    found = shelf.run(JOB)
    assert found.pictures == ("indirect", "direct", "white")
    assert found.entry is not None and not found.report
    assert (found.entry.state, found.entry.goal, found.entry.user) == ("done", "indirect", "anna")
    assert shelf.picture(JOB, "direct") == b"direct"


def test_a_report_is_told_of_only_where_there_is_one(tmp_path: Path) -> None:
    (run(tmp_path, JOB) / "report.html").write_text("<p>")
    (run(tmp_path, OTHER) / "report.html").mkdir()
    shelf = RunShelf(tmp_path)
    assert [(one.job, one.report) for one in shelf.runs()] == [(OTHER, False), (JOB, True)]
    assert shelf.report(JOB) == b"<p>"
    with pytest.raises(RequestError):
        shelf.report(OTHER)


def test_quick_photos_and_calibrations_are_no_runs_but_can_be_seen(tmp_path: Path) -> None:
    run(tmp_path, JOB, "preview")
    run(tmp_path, OTHER, "calibrations")
    shelf = RunShelf(tmp_path)
    assert shelf.runs() == []
    assert shelf.picture(JOB, "white") == b"white"


def test_nothing_else_can_be_had(tmp_path: Path) -> None:
    folder = run(tmp_path, JOB)
    secret = tmp_path / "secret.png"
    secret.write_bytes(b"secret")
    (folder / "preview" / "linked.png").symlink_to(secret)
    os.mkfifo(folder / "preview" / "pipe.png")
    with (folder / "preview" / "large.png").open("wb") as file:
        file.truncate(MOST_PICTURE_BYTES + 1)
    (tmp_path / "captures" / OTHER).symlink_to(folder)
    shelf = RunShelf(tmp_path)
    assert set(shelf.run(JOB).pictures) == {"indirect", "direct", "white", "large"}
    wrong = [
        (JOB, "linked"), (JOB, "pipe"), (JOB, "large"), (JOB, "../../../secret"), (JOB, ""),
        (JOB, "none"), (OTHER, "white"), ("..", "white"), (f"{JOB}/", "white"), ("", "white"),
        (f"../captures/{JOB}", "white"), (f"{JOB}.partial", "white"),
    ]  # fmt: skip
    for job, name in wrong:
        with pytest.raises(RequestError):
            shelf.picture(job, name)
    for job in ("..", ".", "captures", f"{JOB}\n", "captures/" + JOB):
        with pytest.raises(RequestError):
            shelf.run(job)
