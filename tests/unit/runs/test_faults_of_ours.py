"""What a disk or a forged file may do is a typed error; a fault of the program is never hidden."""

from __future__ import annotations

import errno
import fcntl
import os
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import msgspec
import pytest

from pdcd.bench.calibration import RECORD
from pdcd.errors import DecodeError, DiskError, RequestError
from pdcd.files import put
from pdcd.files.inside import open_folder
from pdcd.protocol.entry import RunQuery
from pdcd.runs import index, look, manifest, patterns, provenance, prune
from pdcd.runs.folder import RunFolder, read_manifest
from pdcd.runs.index import find_runs, make_name_query, read_run_at
from pdcd.runs.ledger import read_ledger
from pdcd.runs.place import HeldFolder
from pdcd.runs.verify_calibration import verify_calibration
from tests.run_folders import cut, finished, job


class FaultOfOursError(Exception):
    """None of those that files or disks make."""


def fail(*_: object, **__: object) -> Any:
    raise FaultOfOursError


def of_ledger(folder: Path) -> object:
    with open_folder(folder / f"{job(2)}.partial") as descriptor:
        return read_ledger(descriptor)


def of_removal(folder: Path) -> object:
    return [prune.remove_run(folder, one) for one in prune.find_unwanted_runs(folder, RunQuery())]


def of_put(folder: Path) -> None:
    with open_folder(folder) as descriptor:
        put.write_atomic(descriptor, "a", b"1", replace=False, shown="x")


@pytest.mark.parametrize(
    ("broken", "asked"),
    [
        ("pdcd.runs.folder.read_inner_file", lambda folder: read_manifest(folder / job(1))),
        ("pdcd.runs.manifest._check_goal", lambda _: manifest.parse_manifest(b'{"schema": 1}')),
        ("pdcd.runs.index.read_run_entry", find_runs),
        ("pdcd.runs.index.read_run_entry", lambda folder: read_run_at(folder / job(1))),
        ("pdcd.runs.look.read_inner_file", find_runs),
        ("pdcd.runs.look.msgspec.json.decode", lambda folder: read_run_at(folder / job(1))),
        ("pdcd.runs.look.read_run_start", find_runs),
        ("pdcd.runs.look.open_inner_file", find_runs),
        ("pdcd.runs.look.fcntl.flock", find_runs),
        ("pdcd.runs.walk.os.scandir", find_runs),
        ("pdcd.runs.ledger.read_inner_file", of_ledger),
        ("pdcd.runs.ledger.msgspec.json.decode", of_ledger),
        ("pdcd.runs.patterns.ZipFile", patterns.read_patterns),
        ("pdcd.runs.prune.shutil.rmtree", of_removal),
        ("pdcd.runs.prune.open_state_folder", of_removal),
        ("pdcd.runs.verify_calibration.msgspec.json.decode", verify_calibration),
        ("pdcd.files.put.os.link", of_put),
        ("pathlib.Path.read_text", lambda _: provenance.find_git_commit()),
        ("pdcd.runs.index.msgspec.convert", lambda _: make_name_query("vase")),
    ],
)
def test_no_fault_of_ours_is_hidden(
    broken: str, asked: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished(tmp_path, job(1))
    cut(tmp_path, job(2), {"event": "failed"})
    (tmp_path / "codes.npz").write_bytes(b"x")
    (tmp_path / RECORD).write_bytes(b"{}")
    monkeypatch.setattr(broken, fail)
    with pytest.raises(FaultOfOursError):
        asked(tmp_path)
    assert not (tmp_path / "a").exists()


def test_a_folder_below_that_breaks_the_program_is_not_merely_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished(tmp_path / "captures", job(1))
    scan, left = os.scandir, [0, 1]

    def second(folder: int) -> Iterator[os.DirEntry[str]]:
        return scan(folder) if left.pop() else fail()

    monkeypatch.setattr("pdcd.runs.walk.os.scandir", second)
    with pytest.raises(FaultOfOursError):
        find_runs(tmp_path)


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


@pytest.mark.parametrize(
    "err",
    [
        OSError("x"), KeyError("x"), ValueError("x"), EOFError("x"), NotImplementedError("x"),
        RuntimeError("x"), MemoryError("x"), BadZipFile("x"), zlib.error("x"),
    ],
    ids=repr,
)  # fmt: skip
def test_whatever_forged_arrays_raise_is_damage(
    err: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: object) -> None:
        raise err

    (tmp_path / "codes.npz").write_bytes(b"x")
    monkeypatch.setattr(patterns, "ZipFile", failing)
    with pytest.raises(DecodeError, match="cannot read"):
        patterns.read_patterns(tmp_path)


@pytest.mark.parametrize(
    "err",
    [
        msgspec.MsgspecError("x"), ValueError("x"), TypeError("x"), RecursionError("x"),
        OverflowError("x"),
    ],
    ids=repr,
)  # fmt: skip
def test_whatever_a_forged_manifest_raises_is_damage(
    err: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: object) -> None:
        raise err

    monkeypatch.setattr(manifest, "check_schema", failing)
    with pytest.raises(DecodeError, match=r"capture\.json is damaged: x"):
        manifest.parse_manifest(b"{}")


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
