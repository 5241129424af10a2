"""Folders by their paths, for systems that cannot hold folders by descriptors: Windows, macOS.

`SYSTEM` has the calls of `os` that readers of runs use, with the same names and arguments; `LOCKS`
has the call of `fcntl`. `pdcd.files.system` says when they are used.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PureWindowsPath
from typing import Any

_OWN_FLAGS = ("O_PATH", "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_NOCTTY")
_FIRST_OWN = 1 << 40
"""First of our own flags, above all flags of a system; our own are never passed on."""


class HeldPath(int):
    """Used in place of a descriptor: a number that is not a descriptor, with the path it is for."""

    path: Path

    def __new__(cls, path: Path) -> HeldPath:
        """Hold a path that has no links in it any more."""
        held = super().__new__(cls, -1)
        held.path = path
        return held


class PathCalls:
    """The calls of `os`, by its names; a `dir_fd` is a `HeldPath`. They raise OSError as there."""

    O_PATH, O_DIRECTORY, O_NOFOLLOW, O_NONBLOCK, O_CLOEXEC, O_NOCTTY = (
        _FIRST_OWN << number for number in range(len(_OWN_FLAGS))
    )

    def __getattr__(self, name: str) -> Any:
        """Everything else is the system's own."""
        return getattr(os, name)

    def open(
        self, name: Path | str, flags: int, mode: int = 0o777, *, dir_fd: int | None = None
    ) -> int:
        """A `HeldPath` for a folder, or for anything with O_PATH; else a descriptor."""
        path = _joined(name, dir_fd)
        if not flags & os.O_CREAT:
            found = path.lstat() if flags & self.O_NOFOLLOW else path.stat()
            if flags & self.O_NOFOLLOW and getattr(found, "st_reparse_tag", 0):  # a junction
                raise _error(errno.ELOOP, path)
            if flags & self.O_DIRECTORY and not stat.S_ISDIR(found.st_mode):
                raise _error(errno.ENOTDIR, path)
            if flags & (self.O_PATH | self.O_DIRECTORY):
                return HeldPath(path if flags & self.O_NOFOLLOW else path.resolve(strict=True))
            if stat.S_ISLNK(found.st_mode):
                raise _error(errno.ELOOP, path)
        known = flags & (_FIRST_OWN - 1)
        for own in _OWN_FLAGS:
            if flags & getattr(self, own):
                known |= getattr(os, own, 0)
        return os.open(path, known | getattr(os, "O_BINARY", 0), mode)

    def close(self, descriptor: int) -> None:
        """Close a descriptor; a held path needs no closing."""
        if not isinstance(descriptor, HeldPath):
            os.close(descriptor)

    def fstat(self, descriptor: int) -> os.stat_result:
        """The status of a descriptor; links are not followed."""
        if isinstance(descriptor, HeldPath):
            return descriptor.path.lstat()
        return os.fstat(descriptor)

    def stat(
        self, name: Path | str, *, dir_fd: int | None = None, follow_symlinks: bool = True
    ) -> os.stat_result:
        """The status of a name."""
        return _joined(name, dir_fd).stat(follow_symlinks=follow_symlinks)

    @contextmanager
    def scandir(self, folder: int | Path | str) -> Iterator[Iterator[os.DirEntry[str]]]:
        """The entries of a folder."""
        at = folder.path if isinstance(folder, HeldPath) else folder
        with os.scandir(at) as listed:
            yield listed

    def mkdir(self, name: str, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        """Make a folder."""
        _joined(name, dir_fd).mkdir(mode)

    def unlink(self, name: str, *, dir_fd: int | None = None) -> None:
        """Remove a file."""
        _joined(name, dir_fd).unlink()

    def link(self, name: str, other: str, *, src_dir_fd: int, dst_dir_fd: int) -> None:
        """Give a file a second name, unless that is taken."""
        _joined(other, dst_dir_fd).hardlink_to(_joined(name, src_dir_fd))

    def rename(self, name: str, other: str, *, src_dir_fd: int, dst_dir_fd: int) -> None:
        """Give a file another name, even one that is taken."""
        _joined(name, src_dir_fd).replace(_joined(other, dst_dir_fd))

    def fsync(self, descriptor: int) -> None:
        """Write a file through to the disk; for a folder nothing is done."""
        if not isinstance(descriptor, HeldPath):
            os.fsync(descriptor)

    def pread(self, descriptor: int, size: int, offset: int) -> bytes:
        """Some bytes of a file, without moving its offset."""
        before = os.lseek(descriptor, 0, os.SEEK_CUR)
        try:
            os.lseek(descriptor, offset, os.SEEK_SET)
            return os.read(descriptor, size)
        finally:
            os.lseek(descriptor, before, os.SEEK_SET)

    def geteuid(self) -> int:
        """Number of the user; 0, as in the status of files, where users have no numbers."""
        return os.geteuid() if hasattr(os, "geteuid") else 0

    getuid = geteuid


class NoLocks:
    """Locks of a system that cannot lock folders: as on a disk without locks, it is not known
    whether a run is still being filled."""

    LOCK_SH, LOCK_EX, LOCK_NB, LOCK_UN = 1, 2, 4, 8

    def flock(self, descriptor: int, how: int) -> None:
        """Raise OSError, as on a disk without locks."""
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))


SYSTEM, LOCKS = PathCalls(), NoLocks()


def _joined(name: Path | str, folder: int | None) -> Path:
    """Path of a name in a folder."""
    if folder is None:
        return Path(name)
    if not isinstance(folder, HeldPath):
        raise _error(errno.EBADF, Path(name))
    if name == "..":
        return folder.path.parent
    if name == ".":
        return folder.path
    if not isinstance(name, str) or PureWindowsPath(name).name != name or ":" in name:
        raise _error(errno.EINVAL, folder.path / name)  # it would lead elsewhere
    return folder.path / name


def _error(number: int, path: Path) -> OSError:
    return OSError(number, os.strerror(number), str(path))
