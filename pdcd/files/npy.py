"""numpy's own files, .npy and .npz, from bytes that nobody vouches for.

Shape and type are looked at before memory is taken for the numbers. Pickles are never read: no
type that needs one passes. Of a zip archive only what `numpy.savez` writes is understood, so that
its directory is small and no member grows further than its own header says.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pdcd.files.limits import Limits, Unsound
from pdcd.files.opening import CHUNK_BYTES

Floats = NDArray[np.float64]

NPY_MAGIC = b"\x93NUMPY"
ZIP_MAGIC = b"PK\x03\x04"

MAX_HEADER = 10_000
"""Characters of an .npy header, as numpy has it."""
MAX_MEMBERS = 64
"""Members of an .npz file."""
MAX_DIRECTORY_BYTES = 2**16
"""Size of an .npz file's directory."""

_ITEM = re.compile(
    r"""["'](descr|fortran_order|shape)["']\s*:\s*"""
    r"""(["'][^"']{1,20}["']|True|False|\((?:\s*\d{1,30}\s*,)*(?:\s*\d{1,30})?\s*\))"""
)
_HEADER = re.compile(rf"\{{\s*{_ITEM.pattern}(?:\s*,\s*{_ITEM.pattern}){{2}}\s*,?\s*\}}")

_END, _END_64 = b"PK\x05\x06", b"PK\x06\x07"
_END_BYTES, _END_64_BYTES = 22, 20

# What numpy and zipfile raise on damaged input.
_DAMAGE = (
    ValueError, EOFError, KeyError, TypeError, MemoryError, OverflowError, IndexError,
    RuntimeError, OSError, struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def read_npy(data: bytes, limits: Limits) -> Floats:
    """The array of an .npy file as float64, of any number of dimensions. Raises Unsound."""
    try:
        return _array(io.BytesIO(data), limits)
    except _DAMAGE as err:
        raise _damaged(err) from err


def members(data: bytes) -> tuple[str, ...]:
    """Names of the arrays in an .npz file. Raises Unsound."""
    try:
        with _archive(data) as archive:
            return tuple(_names(archive))
    except _DAMAGE as err:
        raise _damaged(err) from err


def read_npz(data: bytes, wanted: Mapping[str, Limits]) -> dict[str, Floats]:
    """The wanted arrays of an .npz file by name, as float64. Raises Unsound."""
    try:
        with _archive(data) as archive:
            names = _names(archive)
            missing = [name for name in wanted if name not in names]
            if missing:
                raise Unsound(
                    f"it holds no {' and no '.join(missing)}",
                    f"store {', '.join(wanted)} with numpy.savez",
                )
            found = {}
            for name, limits in wanted.items():
                with archive.open(names[name]) as stream:
                    found[name] = _member(name, stream, limits)
            return found
    except _DAMAGE as err:
        raise _damaged(err) from err


def _archive(data: bytes) -> zipfile.ZipFile:
    """The archive, if it ends as those of numpy do and its directory is small."""
    end = data[-_END_BYTES:]
    if len(end) < _END_BYTES or end[:4] != _END or end[-2:] != b"\0\0":
        raise Unsound("it is damaged: no .npz file ends like that", "write it with numpy.savez")
    if data[-_END_BYTES - _END_64_BYTES :][:4] == _END_64:
        raise Unsound("it is a zip archive of a larger kind", "write it with numpy.savez")
    if int.from_bytes(end[12:16], "little") > MAX_DIRECTORY_BYTES:
        raise Unsound("it holds too many files", f"store at most {MAX_MEMBERS} arrays")
    return zipfile.ZipFile(io.BytesIO(data))


def _names(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    listed = archive.infolist()
    if not 0 < len(listed) <= MAX_MEMBERS:
        raise Unsound(
            f"it holds {len(listed)} arrays", f"store one to {MAX_MEMBERS} with numpy.savez"
        )
    for info in listed:
        plain = info.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        if not plain or info.flag_bits & 1:
            raise Unsound("it is packed or locked in a way that is not read", "use numpy.savez")
    return {info.filename.removesuffix(".npy"): info for info in listed}


def _member(name: str, stream: IO[bytes], limits: Limits) -> Floats:
    try:
        return _array(stream, limits)
    except Unsound as err:
        raise Unsound(f"`{name}`: {err.message}", err.hint) from err
    except _DAMAGE as err:
        raise Unsound(f"`{name}`: {_damaged(err).message}", _damaged(err).hint) from err


def _array(stream: IO[bytes], limits: Limits) -> Floats:
    dtype, fortran, shape = _header(stream)
    size = limits.check(shape) * dtype.itemsize
    flat = np.frombuffer(_exactly(stream, size, limits), dtype=dtype)
    with np.errstate(over="ignore"):  # what float64 cannot hold becomes infinite, and is refused
        array = flat.reshape(shape, order="F" if fortran else "C").astype(np.float64, order="C")
    check_finite(array)
    return array


def _header(stream: IO[bytes]) -> tuple[np.dtype[Any], bool, tuple[int, ...]]:
    """Type, order and shape. The header is matched, not evaluated as numpy does it."""
    start = stream.read(8)
    version = (start[6], start[7]) if len(start) == 8 and start.startswith(NPY_MAGIC) else None
    if version not in ((1, 0), (2, 0)):
        raise Unsound("it is no .npy file of version 1.0 or 2.0", "write it with numpy.save")
    length = int.from_bytes(stream.read(2 * version[0]), "little")
    if length > MAX_HEADER:
        raise Unsound(f"its header has {length} characters", "write it with numpy.save")
    text = stream.read(length).decode("latin-1").strip()
    found = dict(_ITEM.findall(text)) if _HEADER.fullmatch(text) else {}
    if found.keys() != {"descr", "fortran_order", "shape"}:
        raise Unsound("its header is not that of real numbers", "store real numbers")
    dtype = np.dtype(found["descr"].strip("'\""))
    if dtype.kind not in "biuf":
        raise Unsound(f"it holds {dtype}, not real numbers", "store real numbers")
    shape = tuple(int(side) for side in re.findall(r"\d+", found["shape"]))
    return dtype, found["fortran_order"] == "True", shape


def check_finite(array: Floats) -> None:
    """Raise Unsound for infinite values and for what is no number: no goal knows what they mean."""
    finite = np.isfinite(array)
    if not finite.all():
        first = ", ".join(map(str, np.argwhere(~finite)[0]))
        raise Unsound(
            f"it has {finite.size - np.count_nonzero(finite)} values that are not finite, the "
            f"first at ({first})",
            "replace NaN and infinity by numbers",
        )


def _exactly(stream: IO[bytes], size: int, limits: Limits) -> bytearray:
    """So many bytes and no more, without room for them before they have come."""
    data = bytearray()
    for piece in _pieces(stream, size):
        limits.alive()
        data += piece
    if len(data) < size:
        raise Unsound(f"it ends after {len(data)} of {size} bytes", "write it again")
    if stream.read(1):
        raise Unsound("more bytes follow than its shape tells", "write it again")
    return data


def _pieces(stream: IO[bytes], size: int) -> Iterator[bytes]:
    while size > 0 and (piece := stream.read(min(CHUNK_BYTES, size))):
        size -= len(piece)
        yield piece


def _damaged(err: BaseException) -> Unsound:
    why = " ".join(str(err).split())[:120] or type(err).__name__
    return Unsound(f"it is damaged: {why}", "write it again with numpy.save or numpy.savez")
