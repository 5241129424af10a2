"""A folder that others write into while it is watched, as a card, a share or another program does.

Whoever may write there chooses names, kinds of files and what they hold. So no link is followed
below the folder, nothing is opened but regular files, and nothing is waited for.
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
"""Folders below each other that are looked into."""
MOST_WATCHED = 200_000
"""Most names in it that are looked at."""
_ASIDE = (".", "@", "#", "$", "~")
"""How names begin that are nobody's photos: hidden and unfinished ones (`._IMG_1.DNG`, `~tmp`), and
what NAS systems keep for themselves (`@eaDir`, `#recycle`, `$RECYCLE.BIN`)."""


class WatchedFile(NamedTuple):
    """What a folder tells of one name, as it was when it was looked at.

    kind : "file", "folder", "symbolic link" ..., or "hard link" of a file that has other names as
        well: nobody can tell whose it is.
    date_ns, changed_ns : when its content, and anything of it, was changed.
    """

    kind: str
    size_bytes: int
    date_ns: int
    changed_ns: int
    number: int


class WatchedFolder:
    """Looks at such a folder. Methods raise OSError when the folder cannot be read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def look(self, alive: Alive = lambda: None) -> dict[str, WatchedFile]:
        """All that lies in it and below, by its name relative to it. `alive` as of `walk_folder`.

        Names are as the disk has them: `to_one_line` makes them fit to show.
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
        """The content of a file. Raises DecodeError for what is none, or is longer."""
        with self._opened(name) as descriptor:
            return read_descriptor(descriptor, most_bytes, alive)

    def hash(self, name: str, most_bytes: int, alive: Alive = lambda: None) -> str:
        """Its SHA-256, hexadecimal. Raises DecodeError as `read`."""
        with self._opened(name) as descriptor:
            return hash_descriptor(descriptor, most_bytes, alive)

    def remove(self, name: str) -> None:
        """Remove a file, through no link."""
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
