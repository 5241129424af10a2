"""Test processes are spared what costs much and shows nothing: large previews, and a slow disk.

Half of the processor's time of a small capture goes into its previews, most of its waiting into the
disk. So previews are small here; tests that look at their size ask for `full_previews`. And nothing
of a test has to outlive a power cut: `fsync` refuses what it refuses, and waits for nothing.
Processes that tests start know nothing of this.
"""

from __future__ import annotations

import errno
import fcntl
import importlib
import os
import stat
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from pdcd.pictures.written import previews

if TYPE_CHECKING:
    from _typeshed import HasFileno

FULL_PX, SMALL_PX = previews.LEAST_PX, 320
"""Width of previews as users have them, and in tests: as small as the scale of a caption lets."""


def looked_at(fd: int | HasFileno) -> None:
    """In place of `os.fsync`."""
    handle = fd if isinstance(fd, int) else fd.fileno()
    kind = os.fstat(handle).st_mode
    if fcntl.fcntl(handle, fcntl.F_GETFL) & os.O_PATH:
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))
    if stat.S_ISFIFO(kind) or stat.S_ISSOCK(kind):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))


@pytest.fixture
def full_previews(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Previews of the size that users have."""
    monkeypatch.setattr(previews, "LEAST_PX", FULL_PX)
    yield


def begin() -> None:
    """Spare this process both."""
    importlib.import_module("pdcd.pictures.written.export")  # which takes the full width with it
    previews.LEAST_PX = SMALL_PX
    os.fsync = looked_at
