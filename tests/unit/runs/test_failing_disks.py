"""A disk that fails is a typed error, and is not taken for anything else."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path
from typing import Any

import pytest

from pdcd.errors import DiskError, RequestError
from pdcd.files import put
from pdcd.files.inside import open_folder
from pdcd.runs import index, look
from pdcd.runs.folder import RunFolder
from pdcd.runs.place import HeldFolder
from tests.run_folders import cut, find_runs, finished, job


def test_a_run_that_goes_while_it_is_looked_at_is_none_and_one_that_cannot_be_read_is_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished(tmp_path, job(1))
    for err, states in (
        (FileNotFoundError(errno.ENOENT, "gone"), []),
        (OSError(errno.EIO, "Input/output error"), ["damaged"]),
    ):

        def failing(*_: object, err: OSError = err) -> None:
            raise err

        monkeypatch.setattr(index, "read_run_entry", failing)
        assert [run.state for run in find_runs(tmp_path)] == states


def test_a_name_that_cannot_be_looked_up_is_not_taken_for_free(tmp_path: Path) -> None:
    with open_folder(tmp_path) as descriptor, pytest.raises(OSError, match="File name too long"):
        put.check_name_free(descriptor, "x" * 300, "x")


def test_a_disk_that_fails_is_not_taken_for_a_folder_that_was_moved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stat = os.stat

    def failing(path: Any, **at: Any) -> os.stat_result:
        if path == "job.partial":
            raise OSError(errno.EIO, "Input/output error")
        return stat(path, **at)

    with HeldFolder.at(tmp_path / "runs") as place, RunFolder(place, "job") as run:
        run.create(min_free_bytes=0)
        monkeypatch.setattr(os, "stat", failing)
        with pytest.raises(DiskError, match="Input/output error"):
            run.finish_with(b"{}", "capture.json", b"x\n", "capture.json.sha256")
        monkeypatch.undo()
        assert run.files() == ()


def test_a_disk_that_fails_is_not_taken_for_a_folder_that_is_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stat = os.stat

    def failing(path: Any, **at: Any) -> os.stat_result:
        if path == "capture.json":
            raise OSError(errno.EIO, "Input/output error")
        return stat(path, **at)

    with monkeypatch.context() as patch:
        patch.setattr(os, "stat", failing)
        with pytest.raises(DiskError):
            HeldFolder.below(tmp_path, "a")


def test_a_file_on_the_way_is_named_as_such_whatever_it_is_called(tmp_path: Path) -> None:
    (tmp_path / job(1)).touch()
    for make in (True, False):
        with pytest.raises(RequestError, match="a symbolic link or a file"):
            HeldFolder.below(tmp_path, job(1), make=make)
    with pytest.raises(RequestError) as told:
        HeldFolder.at(tmp_path / "x.partial")
    assert told.value.message == "'x.partial' is another run, and nothing is written into it"


def test_where_a_disk_has_no_locks_nobody_can_tell_whether_a_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOTSUP, "no locks")

    cut(tmp_path, job(1), {"event": "failed", "message": "late"})
    monkeypatch.setattr(fcntl, "flock", refuse)
    with open_folder(tmp_path) as descriptor:
        assert look.is_being_filled(descriptor) is None
    assert [run.state for run in find_runs(tmp_path)] == ["failed"]
