"""Runs on disk are named without being read, whatever lies beside them."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from pdcd.runs import look, walk
from pdcd.runs.stored import stored_runs

HEAD: dict[str, Any] = {
    "schema": 2,
    "state": "done",
    "request": {"goal": "indirect", "codes": 8},
    "owner": {"uid": 1, "pid": 2, "user": "ada"},
    "started_utc": "2026-01-01T00:00:00Z",
    "files": {"probe.npz": "0" * 64},
}


def name(second: int) -> str:
    return f"20260101T0000{second:02d}Z-00ff"


def write(folder: Path, second: int, **changes: object) -> Path:
    """A finished run, as far as its manifest goes."""
    place = folder / name(second)
    place.mkdir(parents=True)
    text = json.dumps({**HEAD, "job": place.name, **changes})
    (place / "capture.json").write_text(text)
    return place


def test_the_newest_come_first_from_all_folders(tmp_path: Path) -> None:
    write(tmp_path / "captures", 1)
    write(tmp_path / "captures", 3, state="cancelled")
    write(tmp_path / "series" / "monday", 2)
    write(tmp_path / "a" / "b" / "c", 9)  # too deep
    (tmp_path / "captures" / f"{name(4)}.partial").mkdir()
    (tmp_path / "captures" / "notes").mkdir()
    (tmp_path / "captures" / name(8)).touch()  # a file
    found = stored_runs(tmp_path, 10)
    assert [(run.job, run.state) for run in found] == [
        (name(4), "unfinished"), (name(3), "cancelled"), (name(2), "done"), (name(1), "done"),
    ]  # fmt: skip
    assert [run.job for run in stored_runs(tmp_path, 2)] == [name(4), name(3)]
    last = found[-1]
    assert (last.goal, last.user, last.started_utc) == ("indirect", "ada", HEAD["started_utc"])
    assert last.folder == str(tmp_path / "captures" / name(1))
    assert stored_runs(tmp_path / "nowhere", 10) == []


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "\0" * 40, '{"job": 3}', "[" * 100_000,
     json.dumps({**HEAD, "job": name(2)}), json.dumps({**HEAD, "job": name(1), "state": "new"})],
)  # fmt: skip
def test_a_manifest_that_is_none_is_damaged(tmp_path: Path, text: str) -> None:
    (write(tmp_path, 1) / "capture.json").write_text(text)
    (found,) = stored_runs(tmp_path, 10)
    assert (found.state, found.goal) == ("damaged", None)


def test_a_folder_without_a_manifest_is_unfinished(tmp_path: Path) -> None:
    (write(tmp_path, 1) / "capture.json").unlink()
    assert stored_runs(tmp_path, 10)[0].state == "unfinished"


def test_nothing_is_waited_for_and_no_link_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "state"
    for second in (1, 2, 3, 4):
        (write(state, second) / "capture.json").unlink()
    os.mkfifo(state / name(1) / "capture.json")
    (state / name(2) / "capture.json").symlink_to("/dev/zero")
    (state / name(3) / "capture.json").mkdir()
    monkeypatch.setattr(look, "MOST_BYTES", 1000)
    (state / name(4) / "capture.json").write_text(json.dumps({**HEAD, "note": "x" * 1000}))
    elsewhere = write(tmp_path / "elsewhere", 5)
    (state / name(5)).symlink_to(elsewhere)
    (state / "more").symlink_to(tmp_path / "elsewhere")
    (state / os.fsdecode(b"\xff") / name(6)).mkdir(parents=True)  # cannot be told
    assert [(run.job, run.state) for run in stored_runs(state, 10)] == [
        (name(second), "damaged") for second in (4, 3, 2, 1)
    ]


def test_the_search_ends_in_a_folder_of_a_million_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(walk, "MOST_ENTRIES", 5)
    for second in range(9):
        (tmp_path / name(second)).mkdir()
    assert len(stored_runs(tmp_path, 100)) == 5
