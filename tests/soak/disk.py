"""A small file system in memory that can be filled and protected; for root only (mount(2))."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

_READ_ONLY, _REMOUNT, _DETACH = 1, 32, 2
"""MS_RDONLY, MS_REMOUNT and MNT_DETACH of sys/mount.h."""
_libc = ctypes.CDLL(None, use_errno=True)


def mount(folder: Path, size_mib: int) -> bool:
    """Put one over a folder; whether that was permitted."""
    return _mount(folder, 0, f"size={size_mib}m")


def protect(folder: Path) -> bool:
    """Make it read-only; not while a file on it is being written."""
    return _mount(folder, _REMOUNT | _READ_ONLY)


def allow(folder: Path) -> bool:
    """Let it be written to again."""
    return _mount(folder, _REMOUNT)


def unmount(folder: Path) -> None:
    """Take it away, with all that is on it."""
    _libc.umount2(os.fsencode(folder), _DETACH)


def _mount(folder: Path, flags: int, options: str = "") -> bool:
    flagged = ctypes.c_ulong(flags)
    place = os.fsencode(folder)
    return bool(_libc.mount(b"pdcd-soak", place, b"tmpfs", flagged, options.encode()) == 0)
