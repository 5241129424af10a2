"""codes.npz of a run folder: what both panels showed, and the arrays of the request."""

from __future__ import annotations

import os
import zlib
from pathlib import Path
from typing import IO, Any
from zipfile import BadZipFile, ZipFile

from numpy.lib import format as npy
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.files.arrays import ARCHIVE_END_BYTES, check_archive_end
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import open_file

CODES_FILE = "codes.npz"
MAX_CODES_BYTES = 2**31
"""Most bytes that its arrays may hold together: the codes of 65536 refreshes of 512 x 384 cells and
more. A file of 1 MB may claim to hold a thousand times as much."""


def read_patterns(folder: Path) -> dict[str, NDArray[Any]]:
    """The arrays of codes.npz, as `pdcd.runs.folder.RunFolder` stored them. Raises DecodeError."""
    return read_stored_arrays(folder / CODES_FILE)


def read_stored_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz file of a run, which may be damaged. Raises DecodeError."""
    try:
        with open_file(path) as descriptor, os.fdopen(os.dup(descriptor), "rb") as file:
            file.seek(-min(ARCHIVE_END_BYTES, os.fstat(descriptor).st_size), os.SEEK_END)
            check_archive_end(file.read(ARCHIVE_END_BYTES))
            archive = ZipFile(file)
            members = archive.infolist()
            if sum(member.file_size for member in members) > MAX_CODES_BYTES:
                raise ValueError(f"its arrays would take more than {MAX_CODES_BYTES} bytes")
            found = {}
            for member in members:
                with archive.open(member) as stream:
                    _check(stream, member.file_size)
                with archive.open(member) as stream:
                    array = npy.read_array(stream, allow_pickle=False)
                found[member.filename.removesuffix(".npy")] = array
            return found
    except (
        OSError, UnsoundFileError, KeyError, ValueError, EOFError, NotImplementedError,
        RuntimeError, MemoryError, BadZipFile, zlib.error,
    ) as err:  # fmt: skip
        raise DecodeError(f"cannot read {path}: {err}", hint="restore it from a copy") from err


def _check(stream: IO[bytes], size_bytes: int) -> None:
    """Raise ValueError where an array claims to be larger than its file: numpy allocates the memory
    before it reads."""
    read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    version = npy.read_magic(stream)
    if version not in read:
        raise ValueError(f"an array of format {version}")
    shape, _, dtype = read[version](stream)
    count = 1
    for side in shape:
        count *= side
    if count * dtype.itemsize > size_bytes:
        raise ValueError(f"an array of the shape {shape} in {size_bytes} bytes")
