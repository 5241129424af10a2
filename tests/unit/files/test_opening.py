"""Only regular files are opened and read, for those who may read them, and never without end."""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.files.opening import (
    ArrayLimits,
    Asker,
    UnsoundFileError,
    open_beneath,
    open_own,
    open_parcels,
)
from pdcd.files.reading import read_contents, read_pipe
from tests.hostile import files

ROOT_USER = Asker(0, frozenset({0}))
SELF = Asker(os.getuid(), frozenset(os.getgroups()))
NOBODY = Asker(65534, frozenset({65534}))
LIMITS = ArrayLimits(1000)


@contextmanager
def none_left_open() -> Iterator[None]:
    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208 - its own descriptor counts twice
    yield
    assert len(os.listdir("/proc/self/fd")) == before  # noqa: PTH208


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder that others may enter, unlike those of pytest, with files of every kind."""
    with tempfile.TemporaryDirectory() as place:
        Path(place).chmod(0o755)
        made = Path(place) / "arrays"
        files.kinds(made)
        yield made


def read(descriptor: int) -> bytes:
    try:
        return read_contents(descriptor, LIMITS)
    finally:
        os.close(descriptor)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["fifo", "zero", "sub", "socket", "loop", "none", "\0", "a" * 300])
def test_what_is_no_regular_file_is_refused_at_once(folder: Path, name: str) -> None:
    with none_left_open():
        with pytest.raises(UnsoundFileError):
            open_own(folder / name)
        with pytest.raises(UnsoundFileError):
            open_beneath(folder, name, SELF)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["fifo", "zero", "sub"])
@pytest.mark.parametrize("flags", [os.O_RDONLY, os.O_RDWR, os.O_PATH])
def test_an_open_descriptor_of_another_kind_is_not_read(
    folder: Path, name: str, flags: int
) -> None:
    if name == "sub" and flags == os.O_RDWR:
        return
    with pytest.raises(UnsoundFileError):
        read(os.open(folder / name, flags | os.O_NONBLOCK))


def test_pipes_and_sockets_are_not_read() -> None:
    reading, writing = os.pipe()
    for descriptor in (reading, writing):
        with pytest.raises(UnsoundFileError, match="a FIFO"):
            read(descriptor)


@pytest.mark.parametrize("flags", [os.O_WRONLY, os.O_PATH])
def test_a_descriptor_that_gives_no_right_to_read_gives_none(folder: Path, flags: int) -> None:
    """With O_PATH anybody has a descriptor of a file that only root may read."""
    with pytest.raises(UnsoundFileError, match="cannot be opened"):
        read(os.open(folder / "secret", flags))


def test_a_file_larger_than_its_limit_is_not_read(folder: Path) -> None:
    with pytest.raises(UnsoundFileError, match=r"1099511627776 bytes, more than the \d+ allowed"):
        read(open_own(folder / "sparse"))


def test_the_offset_of_the_sender_is_neither_used_nor_moved(folder: Path) -> None:
    descriptor = os.open(folder / "good.npy", os.O_RDONLY)
    os.lseek(descriptor, 50, os.SEEK_SET)
    whole = (folder / "good.npy").read_bytes()
    assert read_contents(descriptor, LIMITS) == whole
    assert os.lseek(descriptor, 0, os.SEEK_CUR) == 50
    os.close(descriptor)


def test_a_file_that_shrinks_while_it_is_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(bytes(3 * 2**20))
    descriptor = open_own(path)
    limits = ArrayLimits(2**20, lambda: os.truncate(path, 100))
    with pytest.raises(UnsoundFileError, match="shorter"):
        read_contents(descriptor, limits)
    os.close(descriptor)


def test_reading_ends_when_nobody_waits_for_it(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(bytes(2**22))
    descriptor = open_own(path)
    over = threading.Event()

    def alive() -> None:
        if over.is_set():
            raise KeyboardInterrupt
        over.set()

    with pytest.raises(KeyboardInterrupt):
        read_contents(descriptor, ArrayLimits(2**20, alive))
    os.close(descriptor)


def test_a_folder_that_cannot_be_found_is_told_of_as_such(folder: Path) -> None:
    (folder.parent / "round").symlink_to(folder.parent / "round")
    for place in ("round", "none", "nul\0byte", "good.npy", f"none/../{folder.name}"):
        with none_left_open(), pytest.raises(UnsoundFileError, match="cannot be opened"):
            open_beneath(folder.parent / place, "good.npy", SELF)


@pytest.mark.parametrize(
    "name",
    ["..", ".", "", "/", "sub/../good.npy", "/etc/passwd", "good.npy/", "//good.npy", "a\0b"],
)
def test_names_that_leave_the_folder_are_refused(folder: Path, name: str) -> None:
    (folder.parent / "outside.npy").write_bytes(b"x")
    for asked in (name, f"../{folder.name}/good.npy", "../outside.npy"):
        with none_left_open(), pytest.raises(UnsoundFileError):
            open_beneath(folder, asked, ROOT_USER)


def test_symbolic_links_below_the_folder_are_not_followed(folder: Path) -> None:
    (folder / "out").symlink_to("/etc")
    for name in ("link", "loop", "out/passwd", "zero"):
        with none_left_open(), pytest.raises(UnsoundFileError, match="symbolic link"):
            open_beneath(folder, name, ROOT_USER)


def test_a_folder_that_is_itself_reached_by_a_link_is_the_operators_choice(folder: Path) -> None:
    (folder.parent / "way").symlink_to(folder)
    assert read(open_beneath(folder.parent / "way", "good.npy", SELF))


@pytest.mark.parametrize(
    ("mode", "asker", "may"),
    [
        (0o604, Asker(1234, frozenset({1234})), True),
        (0o640, Asker(1234, frozenset({1234})), False),
        (0o640, Asker(1234, frozenset({1234, os.getgid()})), True),
        (0o604, Asker(1234, frozenset({os.getgid()})), False),  # the group's bits come first
        (0o044, Asker(os.getuid() or 1, frozenset()), os.getuid() == 0),
        (0o600, NOBODY, False),
        (0o000, ROOT_USER, True),
    ],
)
def test_a_name_is_read_for_those_who_could_read_it(
    folder: Path, mode: int, asker: Asker, may: bool
) -> None:
    (folder / "good.npy").chmod(mode)
    found = os.stat_result((*[mode | 0o100000, 0, 0, 1], os.getuid(), os.getgid(), *[0] * 4))
    if asker.uid == (os.getuid() or 1):  # the same by numbers only: root owns all it makes
        assert asker.may(found, 4) == may
        return
    if may and (os.getuid() == 0 or asker.uid):
        assert read(open_beneath(folder, "good.npy", asker))
    elif not may:
        with none_left_open(), pytest.raises(UnsoundFileError, match="may not read it"):
            open_beneath(folder, "good.npy", asker)


def test_a_closed_folder_on_the_way_closes_all_below_it(folder: Path) -> None:
    (folder / "sub" / "x.npy").write_bytes(files.npy(np.ones((3, 4))))
    assert read(open_beneath(folder, "sub/x.npy", NOBODY))
    for closed in (folder / "sub", folder, folder.parent):
        closed.chmod(0o700)
        with none_left_open(), pytest.raises(UnsoundFileError, match="may not enter"):
            open_beneath(folder, "sub/x.npy", NOBODY)
        closed.chmod(0o755)


def test_a_0600_file_of_another_user_is_no_longer_read_for_a_client(folder: Path) -> None:
    with pytest.raises(UnsoundFileError, match="may not read"):
        open_beneath(folder, "secret", NOBODY)


def test_arrays_and_paths_travel_as_descriptors(folder: Path) -> None:
    array = np.arange(12.0).reshape(3, 4)
    with none_left_open():
        with open_parcels(
            {
                "kernel": array,
                "warp": folder / "good.npy",
                "matrix": "/dev/null"[:0] + str(folder / "good.npy"),
            }
        ) as opened:
            assert read_contents(opened["kernel"].descriptor, LIMITS) == files.npy(array)
            assert opened["kernel"].file is None and opened["warp"].file == "good.npy"
            assert read_contents(opened["matrix"].descriptor, LIMITS)
        for bad in (folder / "fifo", folder / "none", np.array([object()])):
            with (
                pytest.raises(RequestError, match="warp"),
                open_parcels({"kernel": array, "warp": bad}),
            ):
                pass


@pytest.mark.timeout(20)
def test_a_pipe_is_read_to_its_end_within_a_time_and_a_limit(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for data, most, words in ((b"x" * 100_000, 100_000, ""), (b"x" * 9, 8, "more than the 8")):
        writer = threading.Thread(target=write_until_closed, args=(pipe, data))
        with none_left_open():  # its writer, of this process, included
            writer.start()
            if words:
                with pytest.raises(UnsoundFileError, match=words):
                    read_pipe(pipe, most, 10.0)
            else:
                assert read_pipe(pipe, most, 10.0) == data
            writer.join()
    with none_left_open(), pytest.raises(UnsoundFileError, match="nobody writes"):
        read_pipe(pipe, 8, 0.05)


def write_until_closed(pipe: Path, data: bytes) -> None:
    with contextlib.suppress(BrokenPipeError):
        pipe.write_bytes(data)
