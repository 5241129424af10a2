"""A folder that others write into while it is watched: a card, a share, or another program's.

Whoever can write there chooses names, kinds and contents of files. So no link is followed below the
folder, only regular files are opened, and nothing is waited for.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from pdcd.errors import DecodeError
from pdcd.files.inside import open_folder, open_inner_file, open_inner_folder, walk_folder
from pdcd.files.opening import UnsoundFileError, kind_of
from pdcd.files.reading import Alive, hash_descriptor, read_descriptor
from pdcd.printable import to_one_line

_DEPTH = 8
"""Levels of folders that are searched."""
MOST_WATCHED = 200_000
"""Most names that it may hold."""
_ASIDE = (".", "@", "#", "$", "~")
"""First letters of names that are not photos: hidden and unfinished files (`._IMG_1.DNG`, `~tmp`),
and folders of NAS systems (`@eaDir`, `#recycle`, `$RECYCLE.BIN`)."""


class WatchedFile(NamedTuple):
    """The status of one name in a folder, at the time of the look.

    kind : "file", "folder", "symbolic link" ..., or "hard link" for a file that also has other
        names: it is not known whose file it is.
    date_ns, changed_ns : when its content was last changed, and when anything about it was.
    """

    kind: str
    size_bytes: int
    date_ns: int
    changed_ns: int
    number: int


class WatchedFolder:
    """A watched folder. Methods raise OSError when the folder cannot be read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def look(self, alive: Alive = lambda: None) -> dict[str, WatchedFile]:
        """Everything in it and below, by names relative to it. `alive` as for `walk_folder`.

        Names are as on the disk: `to_one_line` makes them fit to show.
        """
        found: dict[str, WatchedFile] = {}
        with open_folder(self.path) as folder:
            for prefix, _, entries in walk_folder(folder, _DEPTH, alive, pass_closed=True):
                entries[:] = [e for e in entries if not e.name.startswith(_ASIDE)]
                for name, status in entries:
                    found[prefix + name] = WatchedFile(
                        _kind(status),
                        status.st_size,
                        status.st_mtime_ns,
                        status.st_ctime_ns,
                        status.st_ino,
                    )
                if len(found) > MOST_WATCHED:
                    raise DecodeError(f"{self.path} holds more than {MOST_WATCHED} names")
        return found

    def read(self, name: str, most_bytes: int, alive: Alive = lambda: None) -> bytes:
        """The content of a file. Raises DecodeError if it is not a regular file, or is longer."""
        with self._opened(name) as descriptor:
            return read_descriptor(descriptor, most_bytes, alive)

    def hash(self, name: str, most_bytes: int, alive: Alive = lambda: None) -> str:
        """The SHA-256 of a file, hexadecimal. Raises DecodeError as `read`."""
        with self._opened(name) as descriptor:
            return hash_descriptor(descriptor, most_bytes, alive)

    def remove(self, name: str) -> None:
        """Remove a file, without following links."""
        above, _, last = name.rpartition("/")
        with open_folder(self.path) as folder, open_inner_folder(folder, above) as at:
            os.unlink(last, dir_fd=at)

    @contextmanager
    def _opened(self, name: str) -> Iterator[int]:
        shown = to_one_line(name)
        try:
            with open_folder(self.path) as folder, open_inner_file(folder, name) as descriptor:
                kind = _kind(os.fstat(descriptor))
                if kind != "file":
                    raise UnsoundFileError(f"it is a {kind}", "have a file of its own saved there")
                yield descriptor
        except UnsoundFileError as err:
            raise DecodeError(f"cannot read {shown}: {err.why}", hint=err.hint) from err


def _kind(status: os.stat_result) -> str:
    kind = kind_of(status.st_mode)
    return "hard link" if kind == "file" and status.st_nlink > 1 else kind
