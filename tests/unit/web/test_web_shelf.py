"""Runs on disk as the page sees them: by name, and nothing but pictures and reports."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pdcd.errors import RequestError
from pdcd.web.shelf import MOST_PICTURE_BYTES, RunShelf
from tests.run_folders import finished, job

JOB, OTHER = "20260101T120301Z-7f3a", "20260101T120302Z-0001"


def run(state: Path, name: str, place: str = "captures") -> Path:
    folder = finished(state / place, name)
    (folder / "preview").mkdir()
    for name in ("white", "indirect", "direct"):
        (folder / "preview" / f"{name}.png").write_bytes(name.encode())
    return folder


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
    for where, name in wrong:
        with pytest.raises(RequestError):
            shelf.picture(where, name)
    for where in ("..", ".", "captures", f"{JOB}\n", "captures/" + JOB):
        with pytest.raises(RequestError):
            shelf.run(where)


def test_the_newest_hundred_runs_are_listed_the_newest_first(tmp_path: Path) -> None:
    names = [job(second, day) for day in (1, 2) for second in range(51)]
    for name in names:
        finished(tmp_path / "captures", name)
    found = RunShelf(tmp_path).runs()
    assert [one.job for one in found] == names[:1:-1] and len(found) == 100
    assert all(one.entry is not None and one.entry.job == one.job for one in found)
    assert not any(one.pictures or one.report for one in found)


def test_the_goal_comes_first_and_what_still_goes_on_last(tmp_path: Path) -> None:
    folder = run(tmp_path, JOB) / "preview"
    for name in ("running", "zoom", "a.b", "x" * 65, "y" * 64):
        (folder / f"{name}.png").touch()
    (folder / "notes.txt").touch()
    wanted = ("indirect", "direct", "white", "y" * 64, "zoom", "running")
    assert RunShelf(tmp_path).run(JOB).pictures == wanted


def test_a_calibration_has_pictures_and_no_entry_finished_or_not(tmp_path: Path) -> None:
    run(tmp_path, JOB, "calibrations")
    (run(tmp_path, f"{OTHER}.partial", "calibrations") / "report.html").write_text("<p>c")
    shelf = RunShelf(tmp_path)
    for name, report in ((JOB, False), (OTHER, True)):
        found = shelf.run(name)
        assert (found.job, found.entry, found.report) == (name, None, report)
        assert found.pictures == ("direct", "indirect", "white")
        assert shelf.picture(name, "white") == b"white"
    assert shelf.report(OTHER) == b"<p>c"


def test_what_cannot_be_had_is_said_with_the_reason(tmp_path: Path) -> None:
    folder = run(tmp_path, JOB)
    with (folder / "report.html").open("wb") as file:
        file.truncate(2**26 + 1)
    with (folder / "preview" / "large.png").open("wb") as file:
        file.truncate(2**25 + 1)
    shelf = RunShelf(tmp_path)
    for wrong, what in (
        (lambda: shelf.picture(JOB, "none"), f"preview/none.png of {JOB} .*: No such file"),
        (lambda: shelf.picture(JOB, "large"), "it has 33554433 bytes, more than the 33554432"),
        (lambda: shelf.report(JOB), "it has 67108865 bytes, more than the 67108864"),
        (lambda: shelf.picture(JOB, "../x"), "no picture is called that"),
        (lambda: shelf.run("x"), "no run is called that"),
        (lambda: shelf.run(OTHER), f"no run is called '{OTHER}'"),
    ):
        with pytest.raises(RequestError, match=what):
            wrong()
