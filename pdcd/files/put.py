"""A file that is there whole or not at all, and that takes no other's place unless it may."""

from __future__ import annotations

import os
import secrets
from contextlib import suppress
from pathlib import Path

from pdcd.errors import RequestError, disk_errors


def replace_file(path: Path, data: bytes) -> None:
    """Write a file that can be made again, in the place of any that is there.

    Raises NoSpaceError, and DiskError for any other refusal of the disk. No half of it is left.
    """
    with disk_errors(str(path)):
        folder = os.open(path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            write_atomic(
                folder, path.name, data, replace=True, shown=str(path.parent), durable=False
            )
        finally:
            os.close(folder)


def write_atomic(
    folder: int, name: str, data: bytes, *, replace: bool, shown: str, durable: bool = True
) -> None:
    """Write a file into an open folder, by its name only when it is complete.

    folder : descriptor; `shown` is what people call it.
    durable : whether it lasts when the power fails; else some of it may then be lost.

    Raises RequestError when there is such a file and it is not to be replaced, NoSpaceError, and
    DiskError for any other refusal of the disk. No half of a file is left.
    """
    unfinished = f".{name}.{secrets.token_hex(4)}"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    with disk_errors(str(Path(shown) / name)):
        descriptor = os.open(unfinished, flags, 0o644, dir_fd=folder)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
                if durable:
                    file.flush()
                    os.fsync(file.fileno())
            _name(folder, unfinished, name, replace=replace, shown=shown)
        finally:
            with suppress(FileNotFoundError):
                os.unlink(unfinished, dir_fd=folder)
        if durable:
            os.fsync(folder)


def check_name_free(folder: int, name: str, shown: str) -> None:
    """Raise RequestError when a folder has something of that name."""
    try:
        os.stat(name, dir_fd=folder, follow_symlinks=False)
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
            os.link(unfinished, name, src_dir_fd=folder, dst_dir_fd=folder)
            return
        except FileExistsError:
            check_name_free(folder, name, shown)
        except OSError:  # a disk without hard links
            check_name_free(folder, name, shown)
    os.rename(unfinished, name, src_dir_fd=folder, dst_dir_fd=folder)
