"""Entry point: ``python -m tests.elsewhere verify FOLDER``: pdcd as on a system that is not Linux.

What Windows lacks is taken away before pdcd is imported: modules, names of `os` and of others,
descriptors of folders; and the packages of the extra `bench`. That is no Windows: paths have no
drive, and files that are open can be removed. Packages of others know what they run on, and keep
what they ask for.
"""

from __future__ import annotations

import importlib.abc
import mmap
import os
import select
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any

MODULES = frozenset(
    """
    fcntl grp pty pwd resource syslog termios tty
    Xlib aiohttp glfw gphoto2 matplotlib moderngl serial usb
    """.split()
)
"""What cannot be imported there, and what a plain installation does not bring."""
NAMES: dict[Any, str] = {
    os: """
        O_PATH O_DIRECTORY O_NOFOLLOW O_NONBLOCK O_CLOEXEC O_NOCTTY O_TMPFILE O_SYNC pread pwrite
        preadv pwritev memfd_create MFD_CLOEXEC MFD_ALLOW_SEALING getuid geteuid getgid getegid
        getgroups fchmod fchown chown lchown fork forkpty sched_getaffinity statvfs fstatvfs mkfifo
        mknod nice killpg getpgid setsid posix_fallocate posix_fadvise sendfile openpty getloadavg
        """,
    socket: "AF_UNIX SOCK_SEQPACKET SCM_RIGHTS recv_fds send_fds",
    select: "poll epoll",
    mmap: "PROT_READ PROT_WRITE MAP_SHARED MAP_PRIVATE",
    signal: "SIGHUP SIGKILL SIGUSR1 pthread_sigmask",
    time: "clock_gettime clock_gettime_ns CLOCK_MONOTONIC CLOCK_REALTIME",
}
_MOST_FLAGS = 1 << 31
_open, _scandir = os.open, os.scandir


class _Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name.partition(".")[0] in MODULES:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None


def _open_file(path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
    """`os.open` of Windows: no folder is opened, and none is gone out from."""
    if dir_fd is not None or flags >= _MOST_FLAGS:
        raise NotImplementedError("dir_fd, or flags that there are not")
    if not flags & _BINARY:
        raise AssertionError("line ends would be changed")
    if Path(path).is_dir() or str(path).startswith("/proc/"):
        raise PermissionError(13, "Permission denied", str(path))
    return _open(path, flags & ~_BINARY, mode)


def _scan(path: Any = ".") -> Iterator[os.DirEntry[Any]]:
    if isinstance(path, int):
        raise TypeError("scandir: path should be string, bytes, os.PathLike or None, not int")
    return _scandir(path)


_BINARY = 0x8000


def leave_linux() -> None:
    """Take all of that away, for the rest of this process."""
    for name in MODULES & sys.modules.keys():
        del sys.modules[name]
    sys.meta_path.insert(0, _Absent())
    for module, names in NAMES.items():
        for name in names.split():
            if hasattr(module, name):
                delattr(module, name)
    os.supports_dir_fd, os.supports_fd = set(), set()
    changed: dict[Any, dict[str, object]] = {
        os: {"open": _open_file, "scandir": _scan, "O_BINARY": _BINARY},
        shutil: {"_use_fd_functions": False},
        tempfile: {"_bin_openflags": os.O_RDWR | os.O_CREAT | os.O_EXCL | _BINARY},
    }
    for module, values in changed.items():
        for name, value in values.items():
            setattr(module, name, value)


if __name__ == "__main__":
    leave_linux()
    from pdcd.cli.main import main

    sys.exit(main(sys.argv[1:]))
