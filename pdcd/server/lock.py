"""A lock file, held for life: only one daemon has what it stands for."""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from pdcd.errors import ConfigError
from pdcd.printable import to_one_line

_OPEN = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


@contextlib.contextmanager
def hold_lock_file(path: Path, what: str, hint: str) -> Iterator[None]:
    """Hold the lock at `path`, which is made, and removed in the end.

    The kernel releases it when this process ends, in whatever way; a file that is left over means
    nothing. Raises ConfigError, with that `hint`, when another process holds it, whose number is
    given; and where no such file can be made.
    """
    try:
        fd = _locked(path, what, hint)
    except OSError as err:
        raise ConfigError(
            f"cannot lock {what} by {path}: {err.strerror or err}",
            hint="see that its folder is there, and that this user may write in it",
        ) from err
    try:
        # Only for people, so a full disk is no reason not to serve.
        with contextlib.suppress(OSError):
            os.ftruncate(fd, 0)
            os.pwrite(fd, f"{os.getpid()} {os.getuid()}\n".encode(), 0)
        yield
    finally:
        # Removed while the lock is held, so that nobody else can have locked it under this name.
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(fd)


def _locked(path: Path, what: str, hint: str) -> int:
    """A descriptor that holds the lock on the file that now lies at `path`."""
    while True:
        fd = os.open(path, _OPEN, 0o600)
        try:
            if not stat.S_ISREG(os.fstat(fd).st_mode):
                raise ConfigError(f"{path} is no file that can be a lock", hint="remove it")
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as err:
                raise ConfigError(f"{what} belongs to {_holder(fd)}", hint=hint) from err
            if _lies_at(path, fd):
                return fd
        except BaseException:
            os.close(fd)
            raise
        os.close(fd)  # its holder has just ended and removed it: begin anew


def _lies_at(path: Path, fd: int) -> bool:
    try:
        now = path.lstat()
    except FileNotFoundError:
        return False
    mine = os.fstat(fd)
    return (now.st_dev, now.st_ino) == (mine.st_dev, mine.st_ino)


def _holder(fd: int) -> str:
    words = os.pread(fd, 64, 0).decode(errors="replace").split()
    if len(words) != 2:
        return "another daemon"  # it has not written its number yet
    pid, uid = map(to_one_line, words)
    return f"another daemon: process {pid} of uid {uid}"
