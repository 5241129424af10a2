"""Only regular files are opened and read, for those who may read them, and never without end."""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.files.arrays import read_npy
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
MIB = 2**20


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
        (made / "sub" / "x.npy").write_bytes(files.npy(np.ones((3, 4))))
        yield made


@pytest.fixture
def flags_of_opened(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The flags of whatever is opened from now on."""
    seen: list[int] = []
    real = os.open

    def noted(path: Any, flags: int, *args: Any, **named: Any) -> int:
        seen.append(flags)
        return real(path, flags, *args, **named)

    monkeypatch.setattr(os, "open", noted)
    return seen


def read(descriptor: int, limits: ArrayLimits = LIMITS) -> bytes:
    try:
        return read_contents(descriptor, limits)
    finally:
        os.close(descriptor)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["fifo", "zero", "sub", "socket", "loop", "none", "\0", "a" * 300])
def test_what_is_no_regular_file_is_refused_unopened(
    folder: Path, flags_of_opened: list[int], name: str
) -> None:
    with none_left_open():
        with pytest.raises(UnsoundFileError):
            open_own(folder / name)
        with pytest.raises(UnsoundFileError):
            open_beneath(folder, name, SELF)
    assert all(flags & os.O_PATH for flags in flags_of_opened)


def test_a_file_is_opened_to_be_read_without_waiting(
    folder: Path, flags_of_opened: list[int]
) -> None:
    for descriptor in (open_own(folder / "good.npy"), open_beneath(folder, "sub/x.npy", SELF)):
        assert not os.get_inheritable(descriptor)
        assert read(descriptor) == files.npy(np.ones((3, 4)))
    for flags in flags_of_opened:
        if flags & os.O_PATH:
            assert flags & os.O_NOFOLLOW
        else:
            assert flags & os.O_NONBLOCK and flags & os.O_NOCTTY
            assert flags & os.O_ACCMODE == os.O_RDONLY


def test_what_became_something_else_meanwhile_is_closed_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The name was of a file when it was looked at, and is of a FIFO when it is opened."""
    good = os.stat(folder / "good.npy")  # noqa: PTH116 - what the module under test calls
    real = os.stat
    monkeypatch.setattr(
        os, "stat", lambda path, **k: good if str(path).endswith("fifo") else real(path, **k)
    )
    with none_left_open(), pytest.raises(UnsoundFileError, match="it is a FIFO"):
        open_own(folder / "fifo")


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


@pytest.mark.parametrize("flags", [os.O_WRONLY, os.O_PATH])
def test_a_descriptor_that_gives_no_right_to_read_gives_none(folder: Path, flags: int) -> None:
    """With O_PATH anybody has a descriptor of a file that only root may read."""
    with pytest.raises(UnsoundFileError, match="cannot be opened"):
        read(os.open(folder / "secret", flags))


def test_a_file_is_as_large_as_its_limit(folder: Path) -> None:
    most = 16 + MIB  # two numbers, and 1 MiB for what is around
    for size, words in (
        (most, ""),
        (1, ""),
        (most + 1, f"it has {most + 1} bytes, more than the {most}"),
        (0, "it is empty"),
    ):
        (folder / "a").write_bytes(os.urandom(size))
        if words:
            with pytest.raises(UnsoundFileError, match=words):
                read(open_own(folder / "a"), ArrayLimits(2))
        else:
            assert read(open_own(folder / "a"), ArrayLimits(2)) == (folder / "a").read_bytes()
    with pytest.raises(UnsoundFileError, match=r"1099511627776 bytes, more than the \d+ allowed"):
        read(open_own(folder / "sparse"))


def test_the_offset_of_the_sender_is_neither_used_nor_moved(folder: Path) -> None:
    descriptor = os.open(folder / "good.npy", os.O_RDONLY)
    os.lseek(descriptor, 50, os.SEEK_SET)
    assert read_contents(descriptor, LIMITS) == (folder / "good.npy").read_bytes()
    assert os.lseek(descriptor, 0, os.SEEK_CUR) == 50
    os.close(descriptor)


def test_a_file_that_changes_while_it_is_read_gives_what_it_held_or_nothing(
    tmp_path: Path,
) -> None:
    path, begun = tmp_path / "x", b"a" * (MIB + MIB // 2)

    def grow() -> None:
        with path.open("ab") as stream:
            stream.write(b"b" * MIB)

    path.write_bytes(begun)
    assert read(open_own(path), ArrayLimits(MIB, grow)) == begun
    with pytest.raises(UnsoundFileError, match="shorter"):
        read(open_own(path), ArrayLimits(MIB, lambda: os.truncate(path, 100)))


def test_a_sign_of_life_comes_with_each_mebibyte_and_may_end_the_reading(tmp_path: Path) -> None:
    signs: list[int] = []
    limits = ArrayLimits(MIB // 2, lambda: signs.append(1))
    (tmp_path / "x").write_bytes(bytes(3 * MIB + 1))
    assert len(read(open_own(tmp_path / "x"), limits)) == 3 * MIB + 1 and len(signs) == 4
    signs.clear()
    read_npy(files.npy(np.zeros((MIB // 8, 3))), limits)
    assert len(signs) == 3

    def end() -> None:
        signs.append(1)
        if len(signs) == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        read(open_own(tmp_path / "x"), ArrayLimits(MIB, end))
    assert len(signs) == 5


def test_a_disk_that_cannot_be_read_is_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any) -> bytes:
        raise OSError(5, "Input/output error")

    descriptor = open_own(folder / "good.npy")
    monkeypatch.setattr(os, "pread", fails)
    with pytest.raises(UnsoundFileError, match="it cannot be opened: Input"):
        read(descriptor)


def test_a_folder_that_cannot_be_found_is_told_of_as_such(folder: Path) -> None:
    (folder.parent / "round").symlink_to(folder.parent / "round")
    for place in ("round", "none", "nul\0byte", "good.npy", f"none/../{folder.name}"):
        with none_left_open(), pytest.raises(UnsoundFileError, match="cannot be opened"):
            open_beneath(folder.parent / place, "good.npy", SELF)


@pytest.mark.parametrize(
    "name",
    ["..", ".", "", "/", "\0", "sub/../good.npy", "sub//x.npy", "/etc/passwd", "good.npy/",
     "//good.npy", "a\0b", "../arrays/good.npy", "../outside.npy"],
)  # fmt: skip
def test_names_that_leave_the_folder_are_refused(
    folder: Path, flags_of_opened: list[int], name: str
) -> None:
    (folder.parent / "outside.npy").write_bytes(b"x")
    flags_of_opened.clear()
    with pytest.raises(UnsoundFileError, match="is no name below the folder of arrays") as caught:
        open_beneath(folder, name, ROOT_USER)
    assert repr(name) in caught.value.message and "without . and .." in caught.value.hint
    assert flags_of_opened == []


def test_symbolic_links_below_the_folder_are_not_followed(folder: Path) -> None:
    (folder / "out").symlink_to("/etc")
    for name in ("link", "loop", "out/passwd", "zero"):
        with none_left_open(), pytest.raises(UnsoundFileError, match="symbolic link"):
            open_beneath(folder, name, ROOT_USER)


def test_a_folder_that_is_itself_reached_by_a_link_is_the_operators_choice(folder: Path) -> None:
    (folder.parent / "way").symlink_to(folder)
    assert read(open_beneath(folder.parent / "way", "good.npy", SELF))


@pytest.mark.parametrize(
    ("mode", "right", "asker", "may"),
    [
        (0o400, 4, Asker(1, frozenset()), True),
        (0o100, 1, Asker(1, frozenset()), True),
        (0o300, 4, Asker(1, frozenset()), False),
        (0o077, 4, Asker(1, frozenset({5})), False),  # the owner's bits come first
        (0o040, 4, Asker(2, frozenset({5})), True),
        (0o010, 1, Asker(2, frozenset({5})), True),
        (0o704, 4, Asker(2, frozenset({5})), False),  # the group's bits come first
        (0o004, 4, Asker(2, frozenset({6})), True),
        (0o770, 4, Asker(2, frozenset({6})), False),
        (0o000, 4, Asker(0, frozenset()), True),
    ],
)
def test_rights_are_those_of_owner_group_or_all_others(
    mode: int, right: int, asker: Asker, may: bool
) -> None:
    found = os.stat_result((0o100000 | mode, 0, 0, 1, 1, 5, 0, 0, 0, 0))
    assert asker.may(found, right) is may


def test_a_file_is_read_for_those_who_could_read_it(folder: Path) -> None:
    file, sub = folder / "sub" / "x.npy", folder / "sub"
    for mode, may in ((0o604, True), (0o605, True), (0o600, False), (0o603, False)):
        file.chmod(mode)
        if may:
            assert read(open_beneath(folder, "sub/x.npy", NOBODY))
            continue
        with none_left_open(), pytest.raises(UnsoundFileError, match="you may not read it"):
            open_beneath(folder, "sub/x.npy", NOBODY)
    file.chmod(0o000)
    if os.getuid() == 0:
        assert read(open_beneath(folder, "sub/x.npy", ROOT_USER))
    file.chmod(0o604)
    sub.chmod(0o701)  # the right to pass is enough
    assert read(open_beneath(folder, "sub/x.npy", NOBODY))
    for closed, mode in ((sub, 0o706), (sub, 0o700), (folder, 0o700), (folder.parent, 0o700)):
        closed.chmod(mode)
        with none_left_open(), pytest.raises(UnsoundFileError, match="you may not enter a folder"):
            open_beneath(folder, "sub/x.npy", NOBODY)
        closed.chmod(0o755)


def test_arrays_contents_and_paths_travel_as_descriptors(folder: Path) -> None:
    array, path = np.arange(12.0).reshape(3, 4), folder / "good.npy"
    with none_left_open():
        with open_parcels(
            {"kernel": array, "prior": b"any bytes", "warp": path, "matrix": str(path)}
        ) as opened:
            assert read_contents(opened["kernel"].descriptor, LIMITS) == files.npy(array)
            assert read_contents(opened["prior"].descriptor, LIMITS) == b"any bytes"
            assert opened["kernel"].file is None and opened["warp"].file == "good.npy"
            assert read_contents(opened["matrix"].descriptor, LIMITS) == path.read_bytes()
            assert not any(os.get_inheritable(one.descriptor) for one in opened.values())
        for bad in (folder / "fifo", folder / "none", np.array([object()])):
            with (
                pytest.raises(RequestError, match="warp"),
                open_parcels({"kernel": array, "warp": bad}),
            ):
                pass


@pytest.mark.parametrize("fault", [OSError(28, "No space"), KeyboardInterrupt()])
def test_a_memory_file_that_cannot_be_written_is_closed(
    monkeypatch: pytest.MonkeyPatch, fault: BaseException
) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise fault

    monkeypatch.setattr(np, "save", fails)
    with (
        none_left_open(),
        pytest.raises(type(fault)),
        open_parcels({"kernel": b"x", "warp": np.zeros((1, 1))}),
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
