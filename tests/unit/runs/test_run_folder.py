"""A run folder by itself: it is whole under its name or it is not there, whatever comes between."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import shutil
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.errors import DecodeError, DiskError, NoSpaceError, PdcdError
from pdcd.files.reading import hash_file
from pdcd.runs import folder as folder_module
from pdcd.runs.folder import RunFolder, read_manifest, write_patterns
from pdcd.runs.place import HeldFolder

DATA = b'{"schema": 1}'
SHA = hashlib.sha256(DATA).hexdigest()


@pytest.fixture
def place(tmp_path: Path) -> Iterator[HeldFolder]:
    with HeldFolder.at(tmp_path / "runs") as place:
        yield place


@pytest.fixture
def run(place: HeldFolder) -> Iterator[RunFolder]:
    with RunFolder(place, "job") as run:
        run.create(min_free_bytes=0)
        yield run


def finish(run: RunFolder) -> str:
    return run.finish_with(DATA, "capture.json", b"digest\n", "capture.json.sha256")


def names(place: HeldFolder) -> list[str]:
    return sorted(path.name for path in place.real.iterdir())


def test_a_folder_is_unfinished_until_it_is_whole(place: HeldFolder, run: RunFolder) -> None:
    assert names(place) == ["job.partial"] and run.where == place.real / "job.partial"
    assert run.files() == ()
    for below in ("raw", "linear", "preview"):
        (run.path / below / "x").write_text("x")
    assert run.files() == ("linear/x", "preview/x", "raw/x")
    assert finish(run) == SHA
    final = place.real / "job"
    assert names(place) == ["job"] and run.where == final
    assert (final / "capture.json").read_bytes() == DATA
    assert (final / "capture.json.sha256").read_bytes() == b"digest\n"
    modes = {p: stat.S_IMODE((final / p / "x").stat().st_mode) for p in ("raw", "linear")}
    assert modes["raw"] == 0o440 and modes["linear"] & 0o200  # nobody writes into a RAW file
    assert hash_file(final / "raw" / "x", 1) == hashlib.sha256(b"x").hexdigest()
    found = run.hashes()
    assert (
        found["raw/x"].sha256 == hashlib.sha256(b"x").hexdigest() and found["raw/x"].size_bytes == 1
    )


def test_others_see_that_somebody_is_at_work(place: HeldFolder, run: RunFolder) -> None:
    """From the moment that it has its name until it is closed."""
    descriptor = os.open(place.real / "job.partial", os.O_RDONLY)
    try:
        with pytest.raises(BlockingIOError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        run.close()
        run.close()
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    finally:
        os.close(descriptor)
    assert run.where is None and run.files() == ()
    with pytest.raises(PdcdError, match="not open"):
        _ = run.fd


def test_a_disk_without_locks_is_good_enough(
    place: HeldFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOTSUP, "no locks")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with RunFolder(place, "job") as run:
        run.create(min_free_bytes=0)
        assert finish(run) == SHA


@pytest.mark.parametrize(("free", "enough"), [(999, False), (1000, True), (1001, True)])
def test_so_many_bytes_stay_free(
    place: HeldFolder, monkeypatch: pytest.MonkeyPatch, free: int, enough: bool
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    with RunFolder(place, "job") as run:
        if enough:
            run.create(min_free_bytes=1000)
        else:
            with pytest.raises(NoSpaceError, match="only 999 bytes are free, 1000 are kept"):
                run.create(min_free_bytes=1000)
        assert names(place) == ["job.partial"] * enough


def a_folder(path: Path) -> None:
    path.mkdir()


def a_dangling_link(path: Path) -> None:
    path.symlink_to("nothing")


@pytest.mark.parametrize("taken", [Path.touch, a_folder, a_dangling_link])
def test_a_name_that_is_taken_is_nobody_elses(
    place: HeldFolder, taken: Callable[[Path], None]
) -> None:
    taken(place.real / "job.partial")
    with RunFolder(place, "job") as run:
        with pytest.raises(DiskError, match="File exists"):
            run.create(min_free_bytes=0)
        assert run.where is None
    assert names(place) == ["job.partial"]


@pytest.mark.parametrize("taken", [Path.touch, a_folder, a_dangling_link])
def test_a_final_name_that_is_taken_leaves_an_unfinished_folder(
    place: HeldFolder, run: RunFolder, taken: Callable[[Path], None]
) -> None:
    taken(place.real / "job")
    with pytest.raises(DiskError, match="name is taken"):
        finish(run)
    assert names(place) == ["job", "job.partial"]
    assert run.files() == ()


def test_a_folder_that_was_moved_does_not_look_finished(place: HeldFolder, run: RunFolder) -> None:
    (place.real / "job.partial").rename(place.real / "elsewhere")
    with pytest.raises(DiskError, match="was moved"):
        finish(run)
    a_folder(place.real / "job.partial")  # another one of that name is not it
    with pytest.raises(DiskError, match="was moved"):
        finish(run)
    assert names(place) == ["elsewhere", "job.partial"]
    assert list((place.real / "elsewhere").rglob("capture*")) == []


@pytest.mark.parametrize("broken", ["sync", "moved"])
def test_a_folder_that_had_its_name_already_gives_it_back(
    place: HeldFolder, run: RunFolder, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    fsync, check, checks = os.fsync, place.check, iter([None, PdcdError("moved out of bounds")])

    def full(handle: int) -> None:
        if os.path.samestat(os.fstat(handle), os.fstat(place.fd)):
            raise OSError(errno.EIO, "Input/output error")
        fsync(handle)

    def moved() -> None:
        check()
        if (error := next(checks)) is not None:
            assert names(place) == ["job"]
            raise error

    if broken == "sync":
        monkeypatch.setattr(os, "fsync", full)
    else:
        monkeypatch.setattr(place, "check", moved)
    with pytest.raises(DiskError if broken == "sync" else PdcdError):
        finish(run)
    assert names(place) == ["job.partial"] and run.files() == ()
    monkeypatch.undo()
    assert finish(run) == SHA  # and may be finished once that is mended


def test_a_place_that_is_not_to_be_written_to_is_asked_first(
    place: HeldFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> None:
        raise PdcdError("it was moved out of its bounds")

    monkeypatch.setattr(place, "check", refuse)
    with RunFolder(place, "job") as run, pytest.raises(PdcdError, match="out of its bounds"):
        run.create(min_free_bytes=0)
    assert names(place) == []


def test_events_are_lines_and_a_full_disk_says_where(
    run: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    run.log({"event": "a"})
    run.log({"event": "b", "n": 1})
    assert (run.path / "log.jsonl").read_text() == '{"event": "a"}\n{"event": "b", "n": 1}\n'

    def full(*_: Any, **__: Any) -> Any:
        raise OSError(errno.ENOSPC, "No space left")

    where = str(run.where)
    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(NoSpaceError) as caught:
        run.log({"event": "c"})
    assert caught.value.device == where


def test_an_exposure_that_is_taken_again_keeps_its_file_under_another_name(run: RunFolder) -> None:
    for name in ("coded.cr2", "coded.jpg", "coded2.cr2"):
        (run.path / "raw" / name).touch()
    assert run.set_aside("coded", 2) == "coded-discarded-2"
    assert run.files() == (
        "raw/coded-discarded-2.cr2",
        "raw/coded-discarded-2.jpg",
        "raw/coded2.cr2",
    )


@pytest.mark.parametrize("there", [False, True])
def test_a_folder_without_a_manifest_says_what_to_give(tmp_path: Path, there: bool) -> None:
    if there:
        (tmp_path / "job").mkdir()
    with pytest.raises(DecodeError, match=r"no readable capture\.json.*ends in \.partial is not"):
        read_manifest(tmp_path / "job")


@pytest.mark.parametrize("fails", ["rename", "unlink"])
def test_what_went_wrong_first_is_what_is_told(
    place: HeldFolder, run: RunFolder, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    """Also where not all of it can be taken back."""
    rename, checks = os.rename, iter([None, PdcdError("moved out of bounds")])

    def moved() -> None:
        if (error := next(checks)) is not None:
            if fails == "unlink":
                (run.path / "capture.json.sha256").unlink()
            else:
                monkeypatch.setattr(os, "rename", refuse)
            raise error

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(place, "check", moved)
    with pytest.raises(PdcdError, match="moved out of bounds"):
        finish(run)
    assert run.files() == ()
    assert names(place) == (["job"] if fails == "rename" else ["job.partial"])
    monkeypatch.setattr(os, "rename", rename)


def test_a_name_that_cannot_be_one_and_a_manifest_that_is_too_large_are_told_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "capture.json").write_bytes(DATA)
    monkeypatch.setattr(folder_module, "MAX_MANIFEST_BYTES", len(DATA) - 1)
    for folder in (tmp_path, Path("a\0b")):
        with pytest.raises(DecodeError, match=r"has no readable capture\.json"):
            read_manifest(folder)


def test_codes_are_written_whole_with_what_made_them(tmp_path: Path) -> None:
    rows = np.arange(6, dtype=np.uint8).reshape(2, 3)
    given = {"matrix": np.eye(2)}
    for seed in (4, 5):
        write_patterns(
            tmp_path, {"a": (rows, rows + 1)}, given, family="hadamard", codes=2, seed=seed
        )
        assert [path.name for path in tmp_path.iterdir()] == ["codes.npz"]
        with np.load(tmp_path / "codes.npz") as found:
            assert (str(found["family"]), int(found["codes"]), int(found["seed"])) == (
                "hadamard", 2, seed,
            )  # fmt: skip
            assert "PCG64" in str(found["generator"])
            np.testing.assert_array_equal(found["a.primal"], rows)
            np.testing.assert_array_equal(found["a.dual"], rows + 1)
            np.testing.assert_array_equal(found["goal.matrix"], np.eye(2))
