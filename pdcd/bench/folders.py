"""Where the daemon listens and keeps its runs: by configuration, systemd or the user's folders."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from pdcd.bench.tables import (
    Config,
)
from pdcd.errors import ConfigError
from pdcd.files.system import system

MAX_SOCKET_BYTES = 107
"""Longest path of a unix socket: `sun_path` of unix(7) less its closing NUL."""


def find_socket_path(config: Config) -> Path:
    """The socket on which the daemon listens and clients call.

    Raises ConfigError when the stand-in for a missing $XDG_RUNTIME_DIR belongs to someone else.
    """
    if config.server.socket is not None:
        return Path(config.server.socket)
    if folder := read_folder_variable("RUNTIME_DIRECTORY"):
        # Beside the folder, not in it: systemd deletes the folder when the service stops.
        return folder.parent / "pdcd.sock"
    return (read_folder_variable("XDG_RUNTIME_DIR") or _private_folder()) / "pdcd.sock"


def find_state_dir(config: Config) -> Path:
    """Folder of run folders and calibrations; it need not exist yet.

    Raises ConfigError where it would lie in the home folder of a user who has none.
    """
    if config.server.state_dir is not None:
        return Path(config.server.state_dir)
    if folder := read_folder_variable("STATE_DIRECTORY"):
        return folder
    if home := read_folder_variable("XDG_STATE_HOME"):
        return home / "pdcd"
    try:
        return Path.home() / ".local" / "state" / "pdcd"
    except RuntimeError as err:  # $HOME is not set, and uid has no entry
        raise ConfigError(
            f"uid {system.getuid()} has no home folder for runs and calibrations",
            hint="set XDG_STATE_HOME or [server] state_dir",
        ) from err


def read_folder_variable(name: str) -> Path | None:
    """First absolute folder of a variable; systemd separates several by colons."""
    first = os.environ.get(name, "").split(":")[0]
    # The XDG base directory specification tells programs to ignore relative values.
    return Path(first) if first.startswith("/") else None


def _private_folder() -> Path:
    """Folder of this user alone below the system's temporary folder, made when missing."""
    folder = Path(tempfile.gettempdir()) / f"pdcd-{system.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
    except OSError as err:
        raise ConfigError(
            f"cannot make the folder {folder}: {err.strerror}",
            hint="set [server].socket",
        ) from err
    found = folder.lstat()
    # Anybody may create names in the temporary folder, a symbolic link included.
    if folder.is_symlink() or found.st_uid != system.getuid() or found.st_mode & 0o077:
        raise ConfigError(
            f"{folder} is not a private folder of this user",
            hint="remove it, or set [server].socket",
        )
    return folder
