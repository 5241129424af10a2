"""Reads and hashes files that somebody else named: in pieces, and up to a limit.

`alive` is called for each piece and may raise, so that a deadline or a cancel can end the reading.
"""

from __future__ import annotations

import hashlib
import io
import os
import select
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pdcd.errors import DecodeError
from pdcd.files.opening import (
    READ_CHUNK_BYTES,
    ArrayLimits,
    UnsoundFileError,
    check_regular,
    make_file_error,
    open_own,
    open_pipe,
)
from pdcd.files.system import system
from pdcd.printable import to_one_line

HASH_CHUNK_BYTES = 2**22
"""Bytes hashed between two signs of life."""
MAX_RAW_BYTES = 2**29
"""Largest RAW file that is read; 150 megapixels, uncompressed, take 300 MB."""
MAX_PICTURE_BYTES = 2**31
"""Largest picture or array file of a run."""

_RIGHT_FILE = "see whether it is the right file"
Alive = Callable[[], object]


def _go_on() -> None:
    """Do nothing: no one is told, and nothing ends the work."""


@contextmanager
def open_file(path: Path | str) -> Iterator[int]:
    """Descriptor of a regular file, with this process' own rights, while the context lasts.

    For callers that must seek in it; `read_file` reads all of it. Raises Unsound.
    """
    descriptor = open_own(path)
    try:
        yield descriptor
    finally:
        system.close(descriptor)


def read_file(path: Path | str, most_bytes: int) -> bytes:
    """All bytes of a regular file that somebody else named. Raises Unsound, also if it is
    longer."""
    with open_file(path) as descriptor:
        return read_descriptor(descriptor, most_bytes)


def read_pipe(path: Path | str, most_bytes: int, within_s: float) -> bytes:
    """All bytes written to a FIFO that the user of the program named, as a shell's ``<(...)``.

    Raises Unsound for more bytes, and if they have not all been written within that time.
    """
    give_up_s = time.monotonic() + within_s
    descriptor = open_pipe(path)
    try:
        return _read_to_end(descriptor, most_bytes, give_up_s)
    except OSError as err:
        raise make_file_error(err) from err
    finally:
        system.close(descriptor)


def _read_to_end(descriptor: int, most_bytes: int, give_up_s: float) -> bytes:
    data, written = b"", select.poll()
    written.register(descriptor, select.POLLIN)
    while written.poll(1e3 * max(0.0, give_up_s - time.monotonic())):
        piece = os.read(descriptor, READ_CHUNK_BYTES)
        if not piece:
            return data
        data += piece
        _check_size(len(data), most_bytes)
    raise UnsoundFileError("nobody writes it to its end", "write to the pipe, and close it")


def read_descriptor(
    descriptor: int, most_bytes: int, alive: Alive = _go_on, hint: str = _RIGHT_FILE
) -> bytes:
    """All bytes of an open file, wherever its offset is.

    The size is checked before anything is read. Bytes that are added meanwhile are left out.
    """
    try:
        found = system.fstat(descriptor)
        check_regular(found)
        size = found.st_size
        _check_size(size, most_bytes, hint)
        data = io.BytesIO()  # it hands over its memory; a bytearray would be copied
        while (done := data.tell()) < size:
            alive()
            piece = system.pread(descriptor, min(READ_CHUNK_BYTES, size - done), done)
            if not piece:
                raise UnsoundFileError(
                    "it became shorter while it was read", "let nobody write to it"
                )
            data.write(piece)
    except OSError as err:
        raise make_file_error(err) from err
    return data.getvalue()


def _check_size(size: int, most_bytes: int, hint: str = _RIGHT_FILE) -> None:
    if size > most_bytes:
        raise UnsoundFileError(f"it has {size} bytes, more than the {most_bytes} allowed", hint)


def read_contents(descriptor: int, limits: ArrayLimits) -> bytes:
    """All bytes of the open file of an array. Raises Unsound, also for an empty file."""
    hint = "give one value for each cell, or one for each pair of them in a matrix"
    data = read_descriptor(descriptor, limits.file_bytes, limits.alive, hint)
    if not data:
        raise UnsoundFileError("it is empty")
    return data


def read_array_file(path: Path | str, limits: ArrayLimits) -> bytes:
    """The same for a file by its name."""
    with open_file(path) as descriptor:
        return read_contents(descriptor, limits)


def hash_file(path: Path | str, most_bytes: int) -> str:
    """SHA-256 of a regular file, hexadecimal. Raises Unsound, also if it is longer."""
    with open_file(path) as descriptor:
        return hash_descriptor(descriptor, most_bytes)


def hash_descriptor(descriptor: int, most_bytes: int, alive: Alive = _go_on) -> str:
    """The same for an open file."""
    try:
        _check_size(system.fstat(descriptor).st_size, most_bytes)
        return hash_open_file(descriptor, alive, most_bytes)[0]
    except OSError as err:
        raise make_file_error(err) from err


def hash_open_file(
    descriptor: int, alive: Alive = _go_on, most_bytes: int | None = None
) -> tuple[str, int]:
    """SHA-256, hexadecimal, and number of bytes of an open file, from its offset on. Raises
    OSError.

    most_bytes : no more bytes than this are read, however many there are; None: all.
    """
    digest, size = hashlib.sha256(), 0
    while chunk := os.read(descriptor, _next_bytes(most_bytes, size)):
        digest.update(chunk)
        size += len(chunk)
        alive()
    return digest.hexdigest(), size


def _next_bytes(most_bytes: int | None, done: int) -> int:
    return HASH_CHUNK_BYTES if most_bytes is None else min(HASH_CHUNK_BYTES, most_bytes - done)


@contextmanager
def refuse_unsound(path: Path | str) -> Iterator[None]:
    """Turn Unsound into DecodeError, the error for a file of a run, which names the file."""
    try:
        yield
    except UnsoundFileError as err:
        raise DecodeError(
            f"cannot read {to_one_line(str(path))}: {err.why}", hint=err.hint
        ) from err
