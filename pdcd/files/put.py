"""Writes files whole or not at all, and replaces an existing file only if allowed."""

from __future__ import annotations

import errno
import os
import re
import secrets
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from pdcd.errors import RequestError, disk_errors
from pdcd.files.system import system

_UNFINISHED = re.compile(r"\.(?P<name>.+)\.[0-9a-f]{8}", re.DOTALL)


def read_final_name(name: str) -> str:
    """The name that a file would have got, of which `write_atomic` leaves an unfinished one where
    the whole process is killed; the name itself for any other file."""
    found = _UNFINISHED.fullmatch(name)
    return name if found is None else found["name"]


def replace_file(path: Path, data: bytes, *, durable: bool = False) -> None:
    """Write a file in place of any that is there. `durable` as for `write_atomic`: needed for what
    cannot be made again.

    Raises RequestError if that is a device, NoSpaceError, and DiskError for any other refusal of
    the disk. No partial file is left.
    """
    with disk_errors(str(path)):
        way = system.O_RDONLY if durable else system.O_PATH  # the latter cannot be synced
        folder = system.open(path.parent, way | system.O_DIRECTORY | system.O_CLOEXEC)
        try:
            shown = str(path.parent)
            write_atomic(folder, path.name, data, replace=True, shown=shown, durable=durable)
        finally:
            system.close(folder)


def check_replaceable(path: Path) -> None:
    """Check, before long work, that `replace_file` can write there. Raises what it raises."""
    with disk_errors(str(path)):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        tempfile.TemporaryFile(dir=path.parent).close()


def write_atomic(
    folder: int, name: str, data: bytes, *, replace: bool, shown: str, durable: bool = True
) -> None:
    """Write a file into an open folder; it gets its name only when it is complete.

    folder : descriptor; `shown` is its name in messages.
    durable : whether the file survives a power failure; else part of it may then be lost.

    Raises RequestError when there is a file of that name that must not be replaced, or a device;
    NoSpaceError; and DiskError for any other refusal of the disk. No partial file is left.
    """
    unfinished = f".{name}.{secrets.token_hex(4)}"  # as `read_final_name` reads it
    flags = system.O_WRONLY | system.O_CREAT | system.O_EXCL | system.O_NOFOLLOW | system.O_CLOEXEC
    with disk_errors(str(Path(shown) / name)):
        descriptor = system.open(unfinished, flags, 0o644, dir_fd=folder)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
                if durable:
                    file.flush()
                    system.fsync(file.fileno())
            _name(folder, unfinished, name, replace=replace, shown=shown)
        finally:
            with suppress(FileNotFoundError):
                system.unlink(unfinished, dir_fd=folder)
        if durable:
            system.fsync(folder)


def check_name_free(folder: int, name: str, shown: str) -> None:
    """Raise RequestError if a folder already has something of that name."""
    try:
        system.stat(name, dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        return
    raise RequestError(
        f"{Path(shown) / name} is there already",
        hint="--force replaces it; --out puts it elsewhere",
    )


def _name(folder: int, unfinished: str, name: str, *, replace: bool, shown: str) -> None:
    if not replace:
        try:
            # Unlike a rename, a link never takes the place of a file.
            system.link(unfinished, name, src_dir_fd=folder, dst_dir_fd=folder)
            return
        except FileExistsError:
            check_name_free(folder, name, shown)
        except OSError:  # a disk without hard links
            check_name_free(folder, name, shown)
    _refuse_others(folder, name, shown)
    system.rename(unfinished, name, src_dir_fd=folder, dst_dir_fd=folder)


def _refuse_others(folder: int, name: str, shown: str) -> None:
    """Raise RequestError if a file would replace a device, such as /dev/null, or a link to
    something that is not a file, such as /dev/stdout."""
    try:
        itself = system.stat(name, dir_fd=folder, follow_symlinks=False).st_mode
        mode = system.stat(name, dir_fd=folder).st_mode
    except OSError:  # nothing, or a link that leads nowhere
        return
    device = stat.S_ISCHR(mode) or stat.S_ISBLK(mode)
    if device or (stat.S_ISLNK(itself) and not stat.S_ISREG(mode)):
        raise RequestError(f"{Path(shown) / name} is no file", hint="name a new file, or another")
