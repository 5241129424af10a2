"""The system's calls on files and folders: those of `os` on Linux, and what stands in elsewhere.

Runs are written, and read, through descriptors of folders: no link leads away, and no renaming on
the way. Linux alone has all that this takes. Elsewhere runs are only read, and what is written are
pages and exported pictures: there a folder is held by its path (`pdcd.files.by_path`), links are
refused as well, and a folder that is renamed while it is read is not noticed. Its files are still
held against their digests.

::

    from pdcd.files.system import locks, system

    at = system.open(name, system.O_PATH | system.O_NOFOLLOW, dir_fd=folder)
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from pdcd.errors import ConfigError

HAS_FOLDER_DESCRIPTORS = hasattr(os, "O_PATH") and os.open in os.supports_dir_fd
"""Whether folders are held by descriptors here, as everything that takes photos asks."""

if TYPE_CHECKING or HAS_FOLDER_DESCRIPTORS:
    import fcntl as locks
    import os as system
else:
    from pdcd.files.by_path import LOCKS as locks  # noqa: N811
    from pdcd.files.by_path import SYSTEM as system  # noqa: N811

__all__ = ["HAS_FOLDER_DESCRIPTORS", "locks", "path_of", "real_path_of", "require_linux", "system"]


def path_of(descriptor: int) -> Path:
    """Path that leads to what a descriptor of this process holds, wherever that was moved to."""
    if HAS_FOLDER_DESCRIPTORS:
        return Path(f"/proc/self/fd/{descriptor}")
    return real_path_of(descriptor)


def real_path_of(descriptor: int) -> Path:
    """Where that lies now, for people. Raises OSError."""
    if HAS_FOLDER_DESCRIPTORS:
        return path_of(descriptor).readlink()
    path: Path = descriptor.path  # type: ignore[attr-defined]
    return path


def require_linux(what: str) -> None:
    """Raise ConfigError where this system has not what taking photos needs.

    Called by all that takes photos or talks with a daemon, before anything else is done. `what` is
    not to be had here, in words.
    """
    if not HAS_FOLDER_DESCRIPTORS:
        raise ConfigError(
            f"{what} needs Linux; on this system finished runs can be read, and no more",
            hint="take photos on the bench's computer, and copy the folders of its runs here",
        )
