"""What is looked at before it is opened, whose faults pass, and how often a reader gives a sign."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.files import opening
from pdcd.files import opening as sending
from pdcd.files.arrays import read_npy
from pdcd.files.opening import (
    ArrayLimits,
    Asker,
    UnsoundFileError,
    open_beneath,
    open_own,
    open_parcels,
)
from pdcd.files.reading import read_contents

SELF = Asker(os.getuid(), frozenset(os.getgroups()))
NOBODY = Asker(65534, frozenset({65534}))
MIB = 2**20


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder that others may enter, with a FIFO, a socket's name, a folder and a file."""
    with tempfile.TemporaryDirectory() as place:
        Path(place).chmod(0o755)
        made = Path(place) / "arrays"
        (made / "sub").mkdir(parents=True)
        os.mkfifo(made / "fifo")
        for name in ("good", "sub/good"):
            (made / name).write_bytes(b"content")
        yield made


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """What is opened from now on, with its flags."""
    seen: list[tuple[str, int]] = []
    real = os.open

    def noted(path: Any, flags: int, *args: Any, **named: Any) -> int:
        seen.append((os.fspath(path), flags))
        return real(path, flags, *args, **named)

    monkeypatch.setattr(os, "open", noted)
    return seen


@pytest.mark.parametrize("name", ["fifo", "sub"])
def test_what_is_no_regular_file_is_not_even_opened(
    folder: Path, opened: list[tuple[str, int]], name: str
) -> None:
    with pytest.raises(UnsoundFileError, match="not a regular file"):
        open_own(folder / name)
    assert opened == []
    with pytest.raises(UnsoundFileError, match="not a regular file"):
        open_beneath(folder, name, SELF)
    assert opened and all(flags & os.O_PATH for _, flags in opened)


def test_a_file_is_opened_to_be_read_without_waiting(
    folder: Path, opened: list[tuple[str, int]]
) -> None:
    for descriptor in (open_own(folder / "good"), open_beneath(folder, "sub/good", SELF)):
        assert os.read(descriptor, 99) == b"content"
        assert not os.get_inheritable(descriptor)
        os.close(descriptor)
    for path, flags in opened:
        if not flags & os.O_PATH:
            assert flags & os.O_NONBLOCK and flags & os.O_NOCTTY, path
            assert flags & os.O_ACCMODE == os.O_RDONLY
        else:
            assert flags & os.O_NOFOLLOW, path


def test_what_became_something_else_meanwhile_is_closed_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The name was of a file when it was looked at, and is of a FIFO when it is opened."""
    good = os.stat(folder / "good")  # noqa: PTH116 - what the module under test calls
    real = os.stat
    monkeypatch.setattr(
        os, "stat", lambda path, **k: good if str(path).endswith("fifo") else real(path, **k)
    )
    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    with pytest.raises(UnsoundFileError, match="it is a FIFO"):
        open_own(folder / "fifo")
    assert len(os.listdir("/proc/self/fd")) == before  # noqa: PTH208


@pytest.mark.parametrize(
    "name", ["sub//good", "good/", "/good", "", ".", "..", "sub/../good", "\0"]
)
def test_names_that_are_none_are_told_as_such(
    folder: Path, opened: list[tuple[str, int]], name: str
) -> None:
    with pytest.raises(UnsoundFileError, match="is no name below the folder of arrays") as caught:
        open_beneath(folder, name, SELF)
    assert repr(name) in caught.value.message and "without . and .." in caught.value.hint
    assert opened == []


@pytest.mark.parametrize(
    ("mode", "may"), [(0o604, True), (0o601, False), (0o602, False), (0o603, False), (0o605, True)]
)
def test_a_file_needs_the_right_to_read(folder: Path, mode: int, may: bool) -> None:
    (folder / "good").chmod(mode)
    if may:
        os.close(open_beneath(folder, "good", NOBODY))
        return
    with pytest.raises(UnsoundFileError, match="you may not read it"):
        open_beneath(folder, "good", NOBODY)


@pytest.mark.parametrize(
    ("mode", "may"), [(0o701, True), (0o705, True), (0o704, False), (0o706, False)]
)
def test_a_folder_needs_the_right_to_pass(folder: Path, mode: int, may: bool) -> None:
    (folder / "sub").chmod(mode)
    if may:
        os.close(open_beneath(folder, "sub/good", NOBODY))
        return
    with pytest.raises(UnsoundFileError, match="you may not enter a folder on the way to it"):
        open_beneath(folder, "sub/good", NOBODY)


def test_faults_of_ours_pass_as_they_are(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise LookupError("ours")

    with monkeypatch.context() as patch:
        patch.setattr(os, "stat", fails)
        with pytest.raises(LookupError):
            open_own(folder / "good")
    with monkeypatch.context() as patch:
        patch.setattr(os, "open", fails)
        with pytest.raises(LookupError):
            open_beneath(folder, "good", SELF)
    descriptor = open_own(folder / "good")
    with monkeypatch.context() as patch:
        patch.setattr(os, "pread", fails)
        with pytest.raises(LookupError):
            read_contents(descriptor, ArrayLimits(9))
    os.close(descriptor)


@pytest.mark.parametrize("fault", [OSError(5, "Input/output error"), OSError("no number")])
def test_a_disk_that_cannot_be_read_is_told(
    folder: Path, monkeypatch: pytest.MonkeyPatch, fault: OSError
) -> None:
    def fails(*_: Any) -> bytes:
        raise fault

    descriptor = open_own(folder / "good")
    monkeypatch.setattr(os, "pread", fails)
    with pytest.raises(UnsoundFileError) as caught:
        read_contents(descriptor, ArrayLimits(9))
    assert caught.value.message == f"it cannot be opened: {fault.strerror or fault}"
    os.close(descriptor)


def test_a_sign_of_life_comes_with_each_mebibyte(tmp_path: Path) -> None:
    signs: list[int] = []
    limits = ArrayLimits(MIB // 2, lambda: signs.append(1))
    (tmp_path / "x").write_bytes(bytes(3 * MIB + 1))
    descriptor = open_own(tmp_path / "x")
    assert len(read_contents(descriptor, limits)) == 3 * MIB + 1 and len(signs) == 4
    os.close(descriptor)
    signs.clear()
    stream = io.BytesIO()
    np.save(stream, np.zeros((MIB // 8, 3)))
    read_npy(stream.getvalue(), limits)
    assert len(signs) == 3


def test_what_a_file_grows_by_while_it_is_read_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"a" * (MIB + MIB // 2))

    def grows() -> None:
        with path.open("ab") as stream:
            stream.write(b"b" * MIB)

    descriptor = open_own(path)
    assert read_contents(descriptor, ArrayLimits(MIB, grows)) == b"a" * (MIB + MIB // 2)
    os.close(descriptor)


def test_a_shape_of_eight_sides_is_told_whole() -> None:
    for sides in (8, 9, 10):
        with pytest.raises(UnsoundFileError) as caught:
            ArrayLimits(9).check((2,) * sides)
        told = " x ".join("2" * 8) + (" ..." if sides > 8 else "")
        assert caught.value.message == f"it has the shape {told}; at most 9 numbers are taken"


def test_a_memory_file_that_cannot_be_written_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only an array of no numbers is the sender's fault."""
    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    for fault, told in (
        (ValueError("bad"), RequestError),
        (OSError(28, "No space"), OSError),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ):

        def fails(*_: Any, fault: BaseException = fault, **__: Any) -> None:
            raise fault

        monkeypatch.setattr(np, "save", fails)
        with pytest.raises(told), open_parcels({"kernel": b"x", "warp": np.zeros((1, 1))}):
            pass
    assert len(os.listdir("/proc/self/fd")) == before  # noqa: PTH208


def test_only_a_refusal_is_told_with_the_name_of_the_array(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: Path) -> int:
        raise LookupError("ours")

    monkeypatch.setattr(sending, "open_own", fails)
    with pytest.raises(LookupError), open_parcels({"kernel": folder / "good"}):
        pass


def test_memory_files_are_not_passed_on(folder: Path) -> None:
    with open_parcels({"kernel": b"x", "warp": folder / "good"}) as sent:
        assert not any(os.get_inheritable(one.descriptor) for one in sent.values())
        link = Path(f"/proc/self/fd/{sent['kernel'].descriptor}").readlink()
        assert str(link).startswith("/memfd:pdcd-kernel")


def test_a_chunk_is_a_mebibyte() -> None:
    assert opening.READ_CHUNK_BYTES == MIB
