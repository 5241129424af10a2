"""Files of a folder that may be damaged or forged: listed, opened and read without leaving it.

Everything is reached through the descriptor of the folder, one part of the name after the other,
and no symbolic link is followed. Only regular files are ever opened: a pipe or a device is
recognised without being opened.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from pdcd.errors import DecodeError, DiskError
from pdcd.files.opening import UnsoundFileError, kind_of
from pdcd.files.reading import Alive, read_descriptor
from pdcd.files.system import path_of, system

MAX_NAME_PARTS = 16
"""Most parts of a file's name, which bounds how deep it lies."""
MAX_ENTRIES = 1_000_000
"""Most files and folders that are listed."""
WAY = system.O_PATH | system.O_DIRECTORY | system.O_NOFOLLOW | system.O_CLOEXEC
"""Flags to open a folder on the way to something, for which the right to pass is enough."""
_FOLDER = system.O_RDONLY | system.O_DIRECTORY | system.O_NOFOLLOW | system.O_CLOEXEC
_SIGN_ENTRIES = 256
"""Names that are read between two signs of life."""


def find_name_fault(name: str) -> str | None:
    """What is wrong with a file's name in a manifest, None if it leads to a file inside."""
    try:
        parts = name.encode().split(b"/")
    except UnicodeEncodeError:
        return "its name is no text"
    if name.startswith("/"):
        return "its name is absolute"
    if b".." in parts:
        return "its name leads out of the folder"
    if b"" in parts or b"." in parts:
        return "its name has empty parts"
    if "\\" in name or ":" in name:
        return "its name leads elsewhere on other systems"
    if any(ord(letter) < 0x20 or ord(letter) == 0x7F for letter in name):
        return "its name has control characters"
    if len(parts) > MAX_NAME_PARTS or any(len(part) > 255 for part in parts):
        return "its name is too long"
    return None


@contextmanager
def open_folder(folder: Path) -> Iterator[int]:
    """Descriptor of a folder, for as long as the context lasts. Raises OSError and ValueError."""
    descriptor = system.open(folder, system.O_RDONLY | system.O_DIRECTORY | system.O_CLOEXEC)
    try:
        yield descriptor
    finally:
        system.close(descriptor)


class FolderEntry(NamedTuple):
    """An entry of a folder: its name there, and its status; links are not followed."""

    name: str
    status: os.stat_result

    @property
    def kind(self) -> str:
        """ "file", "folder", "FIFO" ..."""
        return kind_of(self.status.st_mode)


def list_folder(folder: int) -> dict[str, str]:
    """Everything in a folder and below: relative name -> "file", "folder", "FIFO" ...

    Raises DecodeError when there is too much, and OSError.
    """
    found: dict[str, str] = {}
    for prefix, _, entries in walk_folder(folder, MAX_NAME_PARTS):
        found |= {prefix + entry.name: entry.kind for entry in entries}
        if len(found) > MAX_ENTRIES:
            raise DecodeError(f"it holds more than {MAX_ENTRIES} files")
    return found


def walk_folder(
    folder: int,
    depth: int | None = None,
    alive: Alive = lambda: None,
    *,
    pass_closed: bool = False,
) -> Iterator[tuple[str, int, list[FolderEntry]]]:
    """An open folder and all folders below it, down to `depth` levels. For each: the prefix of the
    names in it, its descriptor, which is valid until the next one, and its entries.

    No link is followed, and only a few folders are open at a time, however deep they lie. A folder
    that the caller removes from the entries is not entered; with `pass_closed`, folders that cannot
    be entered are passed over. `alive` is called now and then; it may raise to end the work. Raises
    OSError, and DiskError if a folder was moved meanwhile.
    """
    at, above, prefix = system.open(".", _FOLDER, dir_fd=folder), list[os.stat_result](), ""
    ahead: list[list[str]] = []
    try:
        while True:
            entries = _entries(at, alive)
            yield prefix, at, entries
            enter = depth is None or len(ahead) + 1 < depth
            ahead.append([e.name for e in reversed(entries) if enter and e.kind == "folder"])
            below = None
            while below is None:
                if ahead[-1]:
                    name = ahead[-1].pop()
                    below = _enter(at, name, pass_closed=pass_closed)
                    continue
                ahead.pop()
                if not ahead:
                    return
                at = _leave(at, _find_above(at, above.pop()))
                prefix = prefix[: prefix.rfind("/", 0, -1) + 1]
            above.append(system.fstat(at))
            at = _leave(at, below)
            prefix += f"{name}/"
    finally:
        system.close(at)


def _leave(left: int, entered: int) -> int:
    system.close(left)
    return entered


def _find_above(at: int, wanted: os.stat_result) -> int:
    """Descriptor of the folder above an open one. Raises DiskError unless it is the `wanted`
    one."""
    up = system.open("..", _FOLDER, dir_fd=at)
    if os.path.samestat(system.fstat(up), wanted):
        return up
    system.close(up)
    raise DiskError("a folder was moved while it was looked at", hint="try again")


def _enter(at: int, name: str, *, pass_closed: bool) -> int | None:
    """Descriptor of a folder in an open one, from which there is a way back. Raises OSError."""
    try:
        below = system.open(name, _FOLDER, dir_fd=at)
    except OSError:
        if pass_closed:
            return None
        raise
    try:
        system.stat("..", dir_fd=below)
    except OSError:
        system.close(below)
        if pass_closed:
            return None
        raise
    return below


def _entries(folder: int, alive: Alive) -> list[FolderEntry]:
    found: list[FolderEntry] = []
    with system.scandir(folder) as listed:
        for number, entry in enumerate(listed):
            if number % _SIGN_ENTRIES == 0:
                alive()
            if number >= MAX_ENTRIES:
                raise DecodeError(f"it holds more than {MAX_ENTRIES} files")
            try:
                found.append(FolderEntry(entry.name, entry.stat(follow_symlinks=False)))
            except FileNotFoundError:  # it has just been removed
                continue
    return found


def remove_folder(parent: int, name: str) -> None:
    """Remove a folder with everything in it, however deep, without following links.

    Raises OSError, and DiskError if one of its folders was moved meanwhile.
    """
    at, above, names = system.open(name, _FOLDER, dir_fd=parent), list[os.stat_result](), [name]
    try:
        ahead = [_remove_files(at)]
        while True:
            if ahead[-1]:
                names.append(ahead[-1].pop())
                above.append(system.fstat(at))
                at = _leave(at, system.open(names[-1], _FOLDER, dir_fd=at))
                ahead.append(_remove_files(at))
                continue
            ahead.pop()
            if not ahead:
                break
            at = _leave(at, _find_above(at, above.pop()))
            system.rmdir(names.pop(), dir_fd=at)
    finally:
        system.close(at)
    system.rmdir(name, dir_fd=parent)


def _remove_files(folder: int) -> list[str]:
    """Remove everything in a folder except folders; returns the names of these."""
    entries = _entries(folder, lambda: None)
    for entry in entries:
        if entry.kind != "folder":
            system.unlink(entry.name, dir_fd=folder)
    return [entry.name for entry in entries if entry.kind == "folder"]


@contextmanager
def open_inner_folder(folder: int, name: str) -> Iterator[int]:
    """Descriptor of a folder below another ("" is that folder itself), to open things in it. No
    link is followed. Raises OSError."""
    with ExitStack() as held:
        at = folder
        for part in name.split("/") if name else ():
            at = system.open(part, WAY, dir_fd=at)
            held.callback(system.close, at)
        yield at


@contextmanager
def open_inner_file(folder: int, name: str) -> Iterator[int]:
    """Descriptor of a regular file in a folder, for reading, while the context lasts.

    Raises DecodeError when it is not a regular file or is reached through a link, and OSError.
    """
    above, _, last = name.rpartition("/")
    with ExitStack() as held:
        at = held.enter_context(open_inner_folder(folder, above))
        found = system.open(last, system.O_PATH | system.O_NOFOLLOW | system.O_CLOEXEC, dir_fd=at)
        held.callback(system.close, found)
        mode = system.fstat(found).st_mode
        if not stat.S_ISREG(mode):
            raise DecodeError(f"it is a {kind_of(mode)}, no file")
        # Open the very file that was checked: its name may mean something else by now.
        flags = system.O_RDONLY | system.O_NONBLOCK | system.O_CLOEXEC
        descriptor = system.open(path_of(found), flags)
        held.callback(system.close, descriptor)
        yield descriptor


def read_inner_file(folder: int, name: str, most_bytes: int) -> bytes:
    """Contents of a regular file in a folder.

    Raises DecodeError when it is not one or is longer than `most_bytes`, and OSError.
    """
    with open_inner_file(folder, name) as descriptor:
        try:
            return read_descriptor(descriptor, most_bytes)
        except UnsoundFileError as err:
            raise DecodeError(err.message) from err
