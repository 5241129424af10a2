"""Folders that `--out` named: noted in the user's own state folder, so that `pdcd runs` finds the
runs in them.

Only their paths are kept. Their contents are read anew each time, and only where they belong to
this user, or to root: others may have put anything there in the meantime.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import msgspec

from pdcd.bench.folders import find_state_dir
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError, PdcdError
from pdcd.files.opening import UnsoundFileError
from pdcd.files.put import replace_file
from pdcd.files.reading import read_file
from pdcd.files.system import system
from pdcd.files.text import encode_json

_FILE = "elsewhere.json"
_MOST_FOLDERS, _MOST_BYTES = 100, 2**20
"""Most noted folders, of which the newest are kept; and the largest file of them that is read."""


def note_folder(folder: Path) -> None:
    """Note a folder into which a command put a run. Failure to note it is ignored: the run is
    complete without."""
    with suppress(OSError, PdcdError, UnicodeEncodeError):
        state, path = find_state_dir(Config()), os.path.realpath(folder)
        others = [other for other in _read_paths(state) if other != path]
        state.mkdir(parents=True, exist_ok=True)
        replace_file(state / _FILE, encode_json([*others, path][-_MOST_FOLDERS:]))


def list_noted_folders() -> tuple[list[Path], list[Path]]:
    """Folders that were noted and are still there: those to be searched, and those of other
    users."""
    try:
        paths = map(Path, _read_paths(find_state_dir(Config())))
    except ConfigError:  # a user without a home
        return [], []
    ours: list[Path] = []
    foreign: list[Path] = []
    for path in paths:
        with suppress(OSError, ValueError):
            if path.is_dir():
                own = path.stat().st_uid in (0, system.geteuid())
                (ours if own else foreign).append(path)
    return ours, foreign


def _read_paths(state: Path) -> list[str]:
    try:
        return msgspec.json.decode(read_file(state / _FILE, _MOST_BYTES), type=list[str])
    except (UnsoundFileError, msgspec.DecodeError):
        return []
