"""The system's calls on files and folders: those of `os` on Linux, and replacements elsewhere.

Runs are written and read through descriptors of folders, so that neither a link nor a renamed
folder can lead elsewhere. Only Linux has all the calls for this. On other systems runs are only
read, and only pages and exported pictures are written. There a folder is held by its path
(`pdcd.files.by_path`): links are refused as well, but a folder that is renamed while it is read is
not noticed. Its files are still checked against their digests.

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
"""Whether this system can hold folders by descriptors, which taking photos requires."""

if TYPE_CHECKING or HAS_FOLDER_DESCRIPTORS:
    import fcntl as locks
    import os as system
else:
    from pdcd.files.by_path import LOCKS as locks  # noqa: N811
    from pdcd.files.by_path import SYSTEM as system  # noqa: N811

__all__ = ["HAS_FOLDER_DESCRIPTORS", "locks", "path_of", "real_path_of", "require_linux", "system"]


def path_of(descriptor: int) -> Path:
    """Path to the file or folder of a descriptor of this process, even if it was moved."""
    if HAS_FOLDER_DESCRIPTORS:
        return Path(f"/proc/self/fd/{descriptor}")
    return real_path_of(descriptor)


def real_path_of(descriptor: int) -> Path:
    """Where that file or folder lies now, for display. Raises OSError."""
    if HAS_FOLDER_DESCRIPTORS:
        return path_of(descriptor).readlink()
    path: Path = descriptor.path  # type: ignore[attr-defined]
    return path


def require_linux(what: str) -> None:
    """Raise ConfigError if this system lacks what taking photos needs.

    Called first by everything that takes photos or talks to a daemon. `what` names in words what is
    not available here.
    """
    if not HAS_FOLDER_DESCRIPTORS:
        raise ConfigError(
            f"{what} needs Linux; on this system finished runs can be read, and no more",
            hint="take photos on the bench's computer, and copy the folders of its runs here",
        )
