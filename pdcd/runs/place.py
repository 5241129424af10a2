"""Where runs are put: a folder held open from when it was allowed until the job has ended.

A path is only a name, and between the check and the use it may come to mean something else. So the
folder is opened part by part, through no symbolic link, and everything is written through its
descriptor: it stays the same folder, wherever it is moved and whatever takes its name.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pdcd.errors import PdcdError, RequestError, disk_errors
from pdcd.files.inside import WAY
from pdcd.files.system import path_of, real_path_of, system
from pdcd.runs.manifest import MANIFEST

UNFINISHED = ".partial"
"""Suffix of the name of a run folder while it is being filled."""

MAX_PATH_PARTS, MAX_PATH_BYTES = 64, 2048
"""Deepest folder, and longest path to it: the files of a run must still have valid paths."""

_JOB_NAME = re.compile(r"\d{8}T\d{6}Z-[0-9a-f]+")
"""Folders with such names are runs. Nobody may make others, which would take the name of a later
run."""

_ASKED_WRONG = (
    errno.EACCES,
    errno.EEXIST,
    errno.EINVAL,
    errno.ELOOP,
    errno.ENAMETOOLONG,
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EPERM,
)
"""Errors of the system for a wrong path, as opposed to a disk that fails."""


class HeldFolder:
    """A folder held by its descriptor; closed by whoever opened it, or by the job it was given to.

    `fd` is the descriptor, `path` leads to the folder within this process, `real` is its current
    place. A child process that is to write there is passed the descriptor.
    """

    def __init__(self, fd: int, bound: tuple[int, int] | None) -> None:
        """Use `below` or `at` instead. `bound`: device and inode of the folder that it must lie
        in."""
        self._fd: int | None = fd
        self._bound = bound

    @classmethod
    def below(cls, root: Path, out: str, *, make: bool = True) -> HeldFolder:
        """The folder `out` below `root`, as a client names it: absolute or relative to the root.

        Missing folders are made; without `make` the result is the deepest folder that exists, which
        serves for reading only. Below the root no symbolic link is followed.

        Raises RequestError when the path leads elsewhere, into another run, or to no folder,
        NoSpaceError, and DiskError when the disk fails.
        """
        with disk_errors(str(root)):
            root.mkdir(parents=True, exist_ok=True)
            top = system.open(root, system.O_PATH | system.O_DIRECTORY | system.O_CLOEXEC)
            info = system.fstat(top)
        with _typed(out):
            try:
                parts = _parts_below(root, out)
            except BaseException:
                system.close(top)
                raise
            return cls._made(top, parts, (info.st_dev, info.st_ino), make=make)

    @classmethod
    def at(cls, path: Path) -> HeldFolder:
        """Any folder, as a user of this machine names it; it is made where it is missing.

        Links on the way to it are followed, but only now. Raises what `below` raises.
        """
        with _typed(str(path)):
            real = path.resolve()
            return cls._made(system.open(real.anchor, WAY), real.parts[1:], None, make=True)

    @classmethod
    def _made(
        cls, top: int, parts: tuple[str, ...], bound: tuple[int, int] | None, *, make: bool
    ) -> HeldFolder:
        """The place to which the parts lead from the folder `top`, which is closed."""
        way = _descended(top, parts, make=make)
        try:
            flags = system.O_RDONLY | system.O_DIRECTORY | system.O_CLOEXEC
            place = cls(system.open(".", flags, dir_fd=way), bound)
        finally:
            system.close(way)
        try:
            place.check()
        except BaseException:
            place.close()
            raise
        return place

    @property
    def fd(self) -> int:
        """The descriptor, open for reading. Raises PdcdError when the place was closed."""
        if self._fd is None:
            raise PdcdError("the folder for the results was closed too early")
        return self._fd

    @property
    def path(self) -> Path:
        """Path to the folder through the descriptor, for use in this process."""
        return path_of(self.fd)

    @property
    def real(self) -> Path:
        """The folder's current path; for people, and for results."""
        return real_path_of(self.fd)

    def check(self) -> None:
        """Raise RequestError unless the folder is still there, in bounds, and in no other run."""
        if not system.fstat(self.fd).st_nlink:
            raise _refused(f"the folder was removed: {self.real}")
        at = system.open(".", WAY, dir_fd=self.fd)
        try:
            while True:
                _refuse_run(at)
                here = system.fstat(at)
                if (here.st_dev, here.st_ino) == self._bound:
                    return
                above = system.open("..", WAY, dir_fd=at)
                system.close(at)
                at = above
                if os.path.samestat(here, system.fstat(at)):
                    break
        finally:
            system.close(at)
        if self._bound is not None:
            raise _refused(f"the folder was moved out of the daemon's state folder: {self.real}")

    def close(self) -> None:
        """Close the folder. Idempotent."""
        fd, self._fd = self._fd, None
        if fd is not None:
            system.close(fd)

    def __enter__(self) -> HeldFolder:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()


def _parts_below(root: Path, out: str) -> tuple[str, ...]:
    """Parts of the path from the root to `out`. The path is not looked up on the disk."""
    home = root.absolute()
    path = Path(os.path.normpath(home / out))
    for base in (Path(os.path.normpath(home)), home.resolve()):
        if path.is_relative_to(base):
            parts = path.relative_to(base).parts
            for name in parts:
                if any(ord(letter) < 0x20 or 0x7F <= ord(letter) < 0xA0 for letter in name):
                    raise _refused(f"control characters in the folder's name {name!r}")
            return parts
    raise RequestError(
        f"out leaves the daemon's state folder: {out!r}",
        hint=f"choose a folder below {home}, or run pdcd capture --local",
    )


def _descended(at: int, parts: tuple[str, ...], *, make: bool) -> int:
    """Descriptor of the folder to which the parts lead from the folder `at`, which is closed."""
    try:
        _refuse_names(parts)
        for number, name in enumerate(parts):
            _refuse_run(at)
            try:
                below = system.open(name, WAY, dir_fd=at)
            except FileNotFoundError:
                taken = next(filter(_JOB_NAME.fullmatch, parts[number:]), None)
                if taken is not None:
                    raise _refused(f"{taken!r} is a name for runs") from None
                if not make:
                    break
                with suppress(FileExistsError):
                    system.mkdir(name, dir_fd=at)
                below = system.open(name, WAY, dir_fd=at)
            system.close(at)
            at = below
    except BaseException:
        system.close(at)
        raise
    return at


def _refuse_names(parts: tuple[str, ...]) -> None:
    """Raise RequestError for names that no folder may have, UnicodeError for invalid text."""
    if len(parts) > MAX_PATH_PARTS or len("/".join(parts).encode()) > MAX_PATH_BYTES:
        raise _refused("the folder's path is too long")
    for name in parts:
        if name.endswith(UNFINISHED):
            raise _inside_run(name)


def _refuse_run(folder: int) -> None:
    """Raise RequestError when an open folder is a run, finished or not."""
    name = real_path_of(folder).name
    try:
        system.stat(MANIFEST, dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        if not name.endswith(UNFINISHED):
            return
    raise _inside_run(name)


def _inside_run(name: str) -> RequestError:
    return _refused(f"{name!r} is another run, and nothing is written into it")


def _refused(why: str) -> RequestError:
    return RequestError(why, hint="name another folder")


@contextmanager
def _typed(out: str) -> Iterator[None]:
    """Turn errors for a path that cannot be opened into typed ones."""
    try:
        with disk_errors(repr(out)[:200]):
            try:
                yield
            except OSError as err:
                if err.errno not in _ASKED_WRONG:
                    raise
                what = "a symbolic link or a file" if err.errno == errno.ENOTDIR else err.strerror
                raise _refused(f"out is not a usable folder: {repr(out)[:200]}: {what}") from err
    except (ValueError, RuntimeError) as err:  # NUL, no text; a loop of links
        raise _refused(f"out is not a usable folder: {repr(out)[:200]}: {err}") from err
