"""Files that are there whole or not at all."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pdcd.errors import DiskError, NoSpaceError, RequestError
from pdcd.files.put import check_name_free, replace_file, write_atomic


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[int]:
    descriptor = os.open(tmp_path, os.O_RDONLY | os.O_DIRECTORY)
    yield descriptor
    os.close(descriptor)


def names(path: Path) -> set[str]:
    return {entry.name for entry in path.iterdir()}


def test_a_file_is_durable_before_it_has_its_name(
    folder: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    fsync, link = os.fsync, os.link

    def synced(descriptor: int) -> None:
        steps.append("file" if os.fstat(descriptor).st_size == 5 else "folder")
        fsync(descriptor)

    def named(*args: Any, **at: Any) -> None:
        steps.append("name")
        link(*args, **at)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "link", named)
    write_atomic(folder, "a", b"12345", replace=False, shown="x")
    assert steps == ["file", "name", "folder"]
    assert names(tmp_path) == {"a"} and (tmp_path / "a").read_bytes() == b"12345"
    assert (tmp_path / "a").stat().st_nlink == 1


@pytest.mark.parametrize("links", [True, False], ids=["links", "no links"])
def test_what_is_there_stays(
    links: bool, folder: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not links:  # as on a stick with FAT

        def refused(*args: str, **at: int) -> None:
            raise PermissionError(errno.EPERM, "no hard links")

        monkeypatch.setattr(os, "link", refused)
    write_atomic(folder, "a", b"old", replace=False, shown="x")
    with pytest.raises(RequestError, match="x/a is there already") as told:
        write_atomic(folder, "a", b"new", replace=False, shown="x")
    assert told.value.hint is not None and "--force" in told.value.hint
    assert names(tmp_path) == {"a"} and (tmp_path / "a").read_bytes() == b"old"
    write_atomic(folder, "a", b"new", replace=True, shown="x")
    assert names(tmp_path) == {"a"} and (tmp_path / "a").read_bytes() == b"new"


def test_a_link_that_leads_nowhere_is_something_that_is_there(folder: int, tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RequestError, match="is there already"):
        check_name_free(folder, "a", "x")
    with pytest.raises(RequestError, match="is there already"):
        write_atomic(folder, "a", b"new", replace=False, shown="x")
    write_atomic(folder, "a", b"new", replace=True, shown="x")
    assert not (tmp_path / "a").is_symlink() and names(tmp_path) == {"a"}


def test_of_many_writers_at_once_one_wins(folder: int, tmp_path: Path) -> None:
    won: list[int] = []
    start = threading.Barrier(8)

    def write(number: int) -> None:
        start.wait()
        try:
            write_atomic(folder, "a", b"%d" % number, replace=False, shown="x")
        except RequestError:
            return
        won.append(number)

    threads = [threading.Thread(target=write, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    (winner,) = won
    assert (tmp_path / "a").read_bytes() == b"%d" % winner and names(tmp_path) == {"a"}


@pytest.mark.parametrize(
    ("number", "error"), [(errno.ENOSPC, NoSpaceError), (errno.EIO, DiskError)]
)
def test_no_half_of_a_file_is_left(
    number: int,
    error: type[Exception],
    folder: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(number, "no")

    (tmp_path / "a").write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(error):
        write_atomic(folder, "a", b"new", replace=True, shown="x")
    assert names(tmp_path) == {"a"} and (tmp_path / "a").read_bytes() == b"old"


@pytest.mark.parametrize("leads_to", ["pipe", "/dev/null"])
def test_no_file_takes_the_place_of_a_link_to_a_device_or_a_pipe(
    leads_to: str, tmp_path: Path
) -> None:
    os.mkfifo(tmp_path / "pipe")
    path = tmp_path / "link"
    path.symlink_to(leads_to)
    with pytest.raises(RequestError, match=f"{path} is no file"):
        replace_file(path, b"new")
    assert path.is_symlink() and names(tmp_path) == {"link", "pipe"}


def test_a_file_that_can_be_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "elsewhere")
    replace_file(tmp_path / "a", b"old")
    assert not (tmp_path / "a").is_symlink() and names(tmp_path) == {"a"}

    def full(*args: str, **at: int) -> None:
        raise OSError(errno.ENOSPC, "no")

    monkeypatch.setattr(os, "rename", full)
    with pytest.raises(NoSpaceError, match=str(tmp_path / "a")):
        replace_file(tmp_path / "a", b"new")
    assert names(tmp_path) == {"a"} and (tmp_path / "a").read_bytes() == b"old"
    with pytest.raises(DiskError):
        replace_file(tmp_path / "no" / "a", b"new")
