"""Opens regular files that somebody else named, and never waits for anything else.

A FIFO would block its reader for good, a device may have effects when it is merely opened, and
reading one may never end. So a file is checked before it is opened, opened without waiting, and
checked again.

Here are also the limits of readers, the one error that they raise, and `open_parcels`, which turns
arrays for the daemon into open files.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import RequestError
from pdcd.files.system import path_of, system

_READ = system.O_RDONLY | system.O_NONBLOCK | system.O_CLOEXEC | system.O_NOCTTY
_LOOK = system.O_PATH | system.O_NOFOLLOW | system.O_CLOEXEC

READ_CHUNK_BYTES = 2**20
"""Bytes that are read at a time."""

_KINDS = {
    stat.S_IFREG: "file",
    stat.S_IFDIR: "folder",
    stat.S_IFIFO: "FIFO",
    stat.S_IFSOCK: "socket",
    stat.S_IFCHR: "device",
    stat.S_IFBLK: "device",
    stat.S_IFLNK: "symbolic link",
}


def kind_of(mode: int) -> str:
    """The name for a thing with this `st_mode`: "file", "folder", "FIFO" ..."""
    return _KINDS.get(stat.S_IFMT(mode), "thing")


@dataclass(frozen=True)
class Asker:
    """The user for whom a file is opened, with all of the user's groups."""

    uid: int
    gids: frozenset[int]

    def may(self, found: os.stat_result, right: int) -> bool:
        """Whether the mode bits give this user a right: 4 to read, 1 to pass through a folder.

        Access control lists are ignored.
        """
        if self.uid == 0:
            return True
        if self.uid == found.st_uid:
            return bool(found.st_mode >> 6 & right)
        return bool(found.st_mode >> (3 if found.st_gid in self.gids else 0) & right)


def open_own(path: Path | str) -> int:
    """A descriptor of a regular file, opened with this process' own rights.

    The caller closes it. Raises Unsound.
    """
    try:
        check_regular(system.stat(path))
        descriptor = system.open(path, _READ)
    except (OSError, ValueError) as err:
        raise make_file_error(err) from err
    return _sure(descriptor)


def open_pipe(path: Path | str) -> int:
    """A descriptor of a FIFO, opened without waiting for a writer.

    The caller closes it. Raises Unsound.
    """
    try:
        descriptor = system.open(path, _READ)
        if not stat.S_ISFIFO(system.fstat(descriptor).st_mode):
            system.close(descriptor)
            raise UnsoundFileError("it is no FIFO any more", "name it again")
    except OSError as err:
        raise make_file_error(err) from err
    return descriptor


def open_beneath(folder: Path, name: str, asker: Asker) -> int:
    """A descriptor of a regular file below a folder, if the asker could read it as well.

    Every folder on the way, starting at /, must let the asker pass. Below `folder` no symbolic link
    is followed. The caller closes the descriptor. Raises Unsound.
    """
    parts = name.split("/")
    if "\0" in name or not all(parts) or {".", ".."} & {*parts}:
        raise UnsoundFileError(
            f"{name!r} is no name below the folder of arrays",
            "give a relative path without . and .., or pass the file itself",
        )
    try:
        way = [*folder.resolve(strict=True).parts, *parts]
        at = system.open(way[0], _LOOK)
        try:
            for part in way[1:]:
                _check_passage(system.fstat(at), asker)
                following = system.open(part, _LOOK, dir_fd=at)
                system.close(at)
                at = following
                found = system.fstat(at)
            check_regular(found)
            if not asker.may(found, 4):
                raise PermissionError(0, "you may not read it")
            descriptor = _reopened(at)
        finally:
            system.close(at)
    except (OSError, ValueError, RuntimeError) as err:
        raise make_file_error(err) from err
    return _sure(descriptor)


def _reopened(looked_at: int) -> int:
    """A descriptor for reading the very file that was checked."""
    return system.open(path_of(looked_at), _READ)


def _check_passage(found: os.stat_result, asker: Asker) -> None:
    if stat.S_ISLNK(found.st_mode):
        raise UnsoundFileError("its name leads through a symbolic link", "name the file itself")
    if stat.S_ISDIR(found.st_mode) and not asker.may(found, 1):
        raise PermissionError(0, "you may not enter a folder on the way to it")


def check_regular(found: os.stat_result) -> None:
    """Raise Unsound for anything but a regular file."""
    if not stat.S_ISREG(found.st_mode):
        kind = kind_of(found.st_mode)
        raise UnsoundFileError(
            f"it is a {kind}, not a regular file", "name a file that can be read to its end"
        )


def _sure(descriptor: int) -> int:
    """The descriptor, if it is still that of a regular file: names can change between two
    checks."""
    try:
        check_regular(system.fstat(descriptor))
    except BaseException:
        system.close(descriptor)
        raise
    return descriptor


def make_file_error(err: Exception) -> UnsoundFileError:
    """The error for a file that the system refuses to open or read."""
    why = err.strerror if isinstance(err, OSError) and err.strerror else str(err)
    return UnsoundFileError(f"{_CLOSED}{why}", "see whether it is there and may be read")


_CLOSED = "it cannot be opened: "


class UnsoundFileError(Exception):
    """A file cannot be used. `message` continues after the file's name; `hint` says what to do.

    Callers know whose file it is, and turn this into the error of a request or of the
    configuration.
    """

    def __init__(self, message: str, hint: str = "write it with numpy.save, or as PNG") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    @property
    def why(self) -> str:
        """The message, for use after words that already say that it cannot be read."""
        return self.message.removeprefix(_CLOSED)


@dataclass(frozen=True)
class ArrayLimits:
    """How large one array may be.

    elements : the most numbers in it.
    alive : called at least once for each MiB read; it may raise to end the work.
    """

    elements: int
    alive: Callable[[], None] = lambda: None

    @property
    def file_bytes(self) -> int:
        """The most bytes of its file: numbers of 8 bytes, and 1 MiB for everything else."""
        return 8 * self.elements + 2**20

    def check(self, shape: tuple[int, ...]) -> int:
        """The count of numbers in an array of that shape. Raises Unsound for none or too many."""
        count = 1
        for side in shape:
            count *= side
        if min(shape, default=1) < 1:
            raise UnsoundFileError(f"it has the shape {_said(shape)}, which holds no number")
        if count > self.elements:
            raise UnsoundFileError(
                f"it has the shape {_said(shape)}; at most {self.elements} numbers are taken",
                "give one value for each cell, or one for each pair of them in a matrix",
            )
        return count


def _said(shape: tuple[int, ...]) -> str:
    """A shape in words, which stays short however long its numbers are."""
    text = " x ".join(str(side) if side < 10**12 else "more than 10^12" for side in shape[:8])
    return text + (" ..." if len(shape) > 8 else "")


Sendable = Path | str | bytes | NDArray[Any]
"""A path of the sender, the content of a file, or an array of real numbers."""


@dataclass(frozen=True)
class _Parcel:
    """One array as an open descriptor, and the name of its file if it has one."""

    descriptor: int
    file: str | None


@contextmanager
def open_parcels(arrays: Mapping[str, Sendable]) -> Iterator[dict[str, _Parcel]]:
    """Open files and put arrays into memory files, by field; all are closed at the end.

    Raises RequestError for a file that cannot be opened, and for arrays that are not numbers.
    """
    with ExitStack() as stack:
        opened = {}
        for name, value in arrays.items():
            if isinstance(value, np.ndarray | bytes):
                parcel = _Parcel(_in_memory(name, value), None)
            else:
                parcel = _opened(name, Path(value))
            stack.callback(os.close, parcel.descriptor)
            opened[name] = parcel
        yield opened


def _opened(name: str, path: Path) -> _Parcel:
    try:
        return _Parcel(open_own(path), path.name)
    except UnsoundFileError as err:
        raise RequestError(f"{name} ({path}): {err.message}", hint=err.hint) from err


def _in_memory(name: str, content: NDArray[Any] | bytes) -> int:
    descriptor = os.memfd_create(f"pdcd-{name}", os.MFD_CLOEXEC)
    try:
        with os.fdopen(os.dup(descriptor), "wb") as stream:
            if isinstance(content, bytes):
                stream.write(content)
            else:
                np.save(stream, content, allow_pickle=False)
    except BaseException as err:
        system.close(descriptor)
        if isinstance(err, ValueError):
            raise RequestError(f"{name} is no array of numbers: {err}") from err
        raise
    return descriptor
