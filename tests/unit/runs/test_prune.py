"""Runs are removed: those that were meant, and nothing else, whatever happens meanwhile."""

from __future__ import annotations

import fcntl
import inspect
import os
import resource
import shutil
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from pdcd.errors import DiskError
from pdcd.files.inside import open_folder
from pdcd.protocol.entry import RunQuery
from pdcd.runs import prune
from pdcd.runs.prune import UnwantedRun, find_unwanted_runs, remove_run
from tests.run_folders import cut, find_runs, finished, job

FAILED = {"event": "failed", "kind": "sync", "message": "late"}


def meant(state: Path, query: RunQuery | None = None, **fields: Any) -> list[str]:
    return [one.run.job for one in find_unwanted_runs(state, query or RunQuery(), **fields)]


def first(state: Path, **fields: Any) -> UnwantedRun:
    return next(find_unwanted_runs(state, RunQuery(), **fields))


def test_what_is_named_together_holds_together(tmp_path: Path) -> None:
    captures = tmp_path / "captures"
    for day in (1, 2, 3, 4):
        finished(captures, job(0, day), request={"tags": ["odd"] * (day % 2)})
        cut(captures, job(1, day), FAILED)
    finished(captures, job(2), "-partial", state="partial")
    (finished(captures, job(3)) / "capture.json").write_text("{")  # damaged: it may be all there is
    finished(tmp_path / "preview", job(9))
    before = datetime(2026, 1, 3, tzinfo=UTC)
    leftovers = [job(1, day) for day in (4, 3, 2, 1)]
    assert meant(tmp_path, leftovers=True) == leftovers
    assert meant(tmp_path, leftovers=True, keep=1) == leftovers[1:]
    assert meant(tmp_path, leftovers=True, keep=1, older_than=before) == leftovers[2:]
    assert meant(tmp_path, leftovers=True, keep=3, older_than=before) == leftovers[3:]
    assert meant(tmp_path, RunQuery(tags=("odd",)), keep=1) == [job(0)]
    older = meant(tmp_path, older_than=datetime(2026, 1, 2, tzinfo=UTC))
    assert older == [job(3), job(2), job(1), job(0)]
    assert job(9) not in meant(tmp_path)


def test_a_run_goes_with_all_that_is_in_it_and_nothing_else(tmp_path: Path) -> None:
    captures, outside = tmp_path / "captures", tmp_path / "outside"
    outside.mkdir()
    (outside / "precious").write_text("x")
    place = finished(captures, job(1))
    (place / "raw").mkdir()
    (place / "raw" / "a.dng").write_bytes(b"x" * 1000)
    (place / "raw" / "a.dng").chmod(0o440)
    (place / "out").symlink_to(outside)
    finished(captures, job(2))
    one = first(tmp_path, keep=1)
    assert one.run.job == job(1) and one.size_bytes > 1000 and not one.removed
    gone = remove_run(tmp_path, one)
    assert gone.removed and gone.why is None
    assert sorted(p.name for p in captures.iterdir()) == [job(2)]
    assert (outside / "precious").read_text() == "x"


def test_folders_in_folders_do_not_keep_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Deeper than Python calls functions and a process holds descriptors, with both set low."""
    place, deep = finished(tmp_path, job(1)), 120
    at = os.open(place, os.O_RDONLY)
    for number in range(deep):
        os.mkdir("d", dir_fd=at)
        below = os.open("d", os.O_RDONLY, dir_fd=at)
        os.symlink("/etc/hostname", f"link-{number}", dir_fd=below)
        os.close(at)
        at = below
    os.close(at)
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    calls = sys.getrecursionlimit()
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (100, limits[1]))
        sys.setrecursionlimit(len(inspect.stack()) + 100)
        gone = remove_run(tmp_path, first(tmp_path))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        sys.setrecursionlimit(calls)
    assert gone.removed and not list(tmp_path.iterdir()) and Path("/etc/hostname").exists()


def test_a_run_that_goes_on_is_never_removed(tmp_path: Path) -> None:
    place = cut(tmp_path, job(1), FAILED)
    one = first(tmp_path)
    held = os.open(place, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)  # as it does that fills it
    try:
        assert meant(tmp_path) == []
        kept = remove_run(tmp_path, one)
    finally:
        os.close(held)
    assert not kept.removed and "still being filled" in (kept.why or "")
    assert (place / "ledger.jsonl").exists()
    assert remove_run(tmp_path, one).removed


def test_nothing_outside_the_state_folder_is_removed(tmp_path: Path) -> None:
    state = tmp_path / "state"
    place = finished(state / "captures", job(1))
    one = first(state)
    elsewhere = finished(tmp_path / "elsewhere", job(1))
    shutil.rmtree(place)
    place.symlink_to(elsewhere)  # its name has come to mean something else
    assert not remove_run(state, one).removed
    place.unlink()
    place.parent.rmdir()
    place.parent.symlink_to(tmp_path / "elsewhere")
    assert not remove_run(state, one).removed
    outside = UnwantedRun(run=one.run, size_bytes=0)
    assert "does not lie" in (remove_run(tmp_path / "another", outside).why or "")
    assert (elsewhere / "capture.json").exists()


def test_a_folder_that_takes_the_name_meanwhile_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = finished(tmp_path, job(1))
    one, lock = first(tmp_path), fcntl.flock

    def swapped(folder: int, how: int) -> None:
        lock(folder, how)
        if how & fcntl.LOCK_EX:
            place.rename(tmp_path / "moved")
            finished(tmp_path, job(1))

    monkeypatch.setattr(fcntl, "flock", swapped)
    kept = remove_run(tmp_path, one)
    assert not kept.removed and "another folder" in (kept.why or "")
    assert (place / "capture.json").exists() and (tmp_path / "moved" / "capture.json").exists()


@pytest.mark.parametrize(
    "ending", ["", "-partial", ".partial", "-decoded-1.partial", "-partial-decoded-12.partial"]
)
def test_an_interrupted_removal_leaves_nothing_that_looks_like_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    finished(tmp_path, job(1), ending, state="partial" if ending == "-partial" else "done")

    def refuse(*_: Any) -> None:
        raise OSError(5, "broken")

    with monkeypatch.context() as patch:
        patch.setattr(prune, "remove_folder", refuse)
        kept = remove_run(tmp_path, first(tmp_path))
    assert not kept.removed and "broken" in (kept.why or "")
    (left,) = find_runs(tmp_path)
    assert left.state == "unfinished" and left.folder.endswith(f"{job(1)}{ending}.removed")
    assert remove_run(tmp_path, first(tmp_path, leftovers=True)).removed
    assert not list(tmp_path.iterdir())


def test_what_is_to_go_has_its_size_and_is_told_what_kept_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    captures = tmp_path / "captures"
    place = finished(captures, job(1))
    (place / "raw").mkdir()
    (place / "raw" / "a").write_bytes(b"x" * 1000)
    size = 1000 + (place / "capture.json").stat().st_size
    one = first(tmp_path)
    assert (one.size_bytes, one.removed, one.why) == (size, False, None)
    monkeypatch.setattr(prune, "MOST_FILES", 1)
    assert first(tmp_path).size_bytes == 0
    kept = remove_run(tmp_path, one)
    assert not kept.removed and "holds more than 1 files" in str(kept.why) and place.exists()
    monkeypatch.setattr(prune, "MOST_FILES", 2)
    gone = remove_run(tmp_path, one)
    assert gone.removed and gone.why is None and not [*captures.iterdir()]
    again = remove_run(tmp_path, one)
    assert not again.removed and again.why


@pytest.mark.parametrize("ending", ["", ".partial"])
def test_without_locks_only_finished_runs_are_removed(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(fd: int, how: int) -> None:
        raise OSError(95, "not supported")

    place = cut(tmp_path, job(1)) if ending else finished(tmp_path, job(1))
    one = first(tmp_path)
    monkeypatch.setattr(fcntl, "flock", none)
    assert remove_run(tmp_path, one).removed != bool(ending)
    assert place.exists() == bool(ending)


def test_another_disk_in_a_run_is_not_emptied(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("x")
    with open_folder(tmp_path) as folder:
        here = os.fstat(folder).st_dev
        assert prune._measured(folder, here) == prune._measured(folder, None) == 1
        with pytest.raises(DiskError, match="another disk"):
            prune._measured(folder, here + 1)
