"""Files of a folder that may be damaged or forged: listed, opened and read without being led away.

Everything is reached through the descriptor of the folder, one part of the name after the other,
and no symbolic link is followed. Only regular files are ever opened: a pipe or a device is seen for
what it is without being touched.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from pdcd.errors import DecodeError
from pdcd.files.opening import kind_of

MAX_NAME_PARTS = 16
"""Deepest file of a folder: parts of its name."""
MAX_ENTRIES = 1_000_000
"""Most files and folders that are listed."""
HASH_CHUNK_BYTES = 2**22
"""Bytes hashed between two signs of life."""

WAY = os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
"""Flags to open a folder on the way to something, which takes no more than the right to pass."""


def path_of(descriptor: int) -> Path:
    """Path that leads to what a descriptor of this process holds, wherever that was moved to."""
    return Path(f"/proc/self/fd/{descriptor}")


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
    if any(ord(letter) < 0x20 or ord(letter) == 0x7F for letter in name):
        return "its name has control characters"
    if len(parts) > MAX_NAME_PARTS or any(len(part) > 255 for part in parts):
        return "its name is too long"
    return None


@contextmanager
def open_folder(folder: Path) -> Iterator[int]:
    """Descriptor of a folder, for as long as the context lasts. Raises OSError and ValueError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def list_folder(folder: int) -> dict[str, str]:
    """All that lies in a folder and below: relative name -> "file", "folder", "FIFO" ...

    Raises DecodeError when that is too much, and OSError.
    """
    found: dict[str, str] = {}
    _list(folder, "", found, MAX_NAME_PARTS)
    return found


def _list(folder: int, prefix: str, found: dict[str, str], depth: int) -> None:
    with os.scandir(folder) as entries:
        for entry in entries:
            if len(found) >= MAX_ENTRIES:
                raise DecodeError(f"it holds more than {MAX_ENTRIES} files")
            mode = entry.stat(follow_symlinks=False).st_mode
            kind = found[prefix + entry.name] = kind_of(mode)
            if kind == "folder" and depth > 1:
                flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
                below = os.open(entry.name, flags, dir_fd=folder)
                try:
                    _list(below, f"{prefix}{entry.name}/", found, depth - 1)
                finally:
                    os.close(below)


@contextmanager
def open_inner_file(folder: int, name: str) -> Iterator[int]:
    """Descriptor of a regular file of a folder, to be read, while the context lasts.

    Raises DecodeError when it is no regular file or a link leads to it, and OSError.
    """
    with ExitStack() as held:

        def hold(path: str, flags: int, at: int | None) -> int:
            descriptor = os.open(path, flags | os.O_CLOEXEC, dir_fd=at)
            held.callback(os.close, descriptor)
            return descriptor

        at, parts = folder, name.split("/")
        for part in parts[:-1]:
            at = hold(part, WAY, at)
        found = hold(parts[-1], os.O_PATH | os.O_NOFOLLOW, at)
        mode = os.fstat(found).st_mode
        if not stat.S_ISREG(mode):
            raise DecodeError(f"it is a {kind_of(mode)}, no file")
        # What is opened is what was looked at: a name may have come to mean something else.
        yield hold(str(path_of(found)), os.O_RDONLY | os.O_NONBLOCK, None)


def read_inner_file(folder: int, name: str, most_bytes: int) -> bytes:
    """Contents of a regular file of a folder.

    Raises DecodeError when it is none or longer than that, and OSError.
    """
    with open_inner_file(folder, name) as descriptor:
        # One byte more than allowed tells a longer file, one that still grows as well.
        size = os.fstat(descriptor).st_size
        if size <= most_bytes:
            with os.fdopen(os.dup(descriptor), "rb") as file:
                data = file.read(most_bytes + 1)
            if len(data) <= most_bytes:
                return data
        raise DecodeError(f"it has {size} bytes, more than the {most_bytes} allowed")


def hash_open_file(descriptor: int, alive: Callable[[], object] = lambda: None) -> tuple[str, int]:
    """SHA-256, hexadecimal, and bytes of an open file, from where it stands. Raises OSError.

    `alive` is called now and then, and may raise to end the work.
    """
    digest, size = hashlib.sha256(), 0
    while chunk := os.read(descriptor, HASH_CHUNK_BYTES):
        digest.update(chunk)
        size += len(chunk)
        alive()
    return digest.hexdigest(), size
