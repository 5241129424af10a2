"""Folders that `--out` named: noted in the user's own state folder, so that `pdcd runs` finds what
went there.

No more than their paths is kept. What lies in them is looked at anew each time, and only in those
that belong to this user, or to root: others may have put anything there meanwhile.
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
"""Noted folders, the newest; and the longest file of them that is read."""


def note_folder(folder: Path) -> None:
    """Note a folder that a command put a run into. What cannot be noted is left out: the run is
    whole without."""
    with suppress(OSError, PdcdError, UnicodeEncodeError):
        state, path = find_state_dir(Config()), os.path.realpath(folder)
        others = [other for other in _read_paths(state) if other != path]
        state.mkdir(parents=True, exist_ok=True)
        replace_file(state / _FILE, encode_json([*others, path][-_MOST_FOLDERS:]))


def list_noted_folders() -> tuple[list[Path], list[Path]]:
    """Folders that were noted and are still there: those to be looked into, and those of others."""
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
