"""Arrays from the bytes of an untrusted file: .npy, .npz, or grey values of PNG. The bytes decide
which, not a name.

Shape and type are checked before memory is taken for the numbers. Pickles are never read: no type
that needs one passes. Zip archives must be as `numpy.savez` writes them: with a small directory,
and no member longer than its own header says. A PNG is checked first (its size, its checksums, the
length of its pixels) and decoded only if it is sound.
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

from pdcd.files.opening import READ_CHUNK_BYTES, ArrayLimits, UnsoundFileError

_Floats = NDArray[np.float64]

_NPY_MAGIC = b"\x93NUMPY"
ZIP_MAGIC = b"PK\x03\x04"

_MAX_HEADER = 2048
"""Most characters of an .npy header; numpy accepts 10000 and writes 118 for arrays of numbers."""
_MAX_MEMBERS = 64
"""Most members of an .npz file."""
MAX_DIRECTORY_BYTES = 2**16
"""Largest directory of an .npz file."""

_WORD = re.compile(r"""'[^']{0,20}'|"[^"]{0,20}"|\w+|\S""")
"""The words of a header. No two alternatives begin alike, so that matching never backtracks."""
_ITEM = re.compile(
    r"""["'](descr|fortran_order|shape)["'] : """
    r"""(["'][^"']{1,20}["']|True|False|\( (?:\d{1,30} , ){0,32}(?:\d{1,30} )?\))"""
)
_HEADER = re.compile(rf"\{{ {_ITEM.pattern}(?: , {_ITEM.pattern}){{2}}(?: ,)? \}}")
"""A header: its words with a space between each two."""

_END, _END_64 = b"PK\x05\x06", b"PK\x06\x07"
_END_BYTES = 22
ARCHIVE_END_BYTES = _END_BYTES + 20

# What numpy and zipfile raise on damaged input.
_DAMAGE = (
    ValueError, EOFError, KeyError, TypeError, MemoryError, OverflowError, IndexError,
    RuntimeError, OSError, struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def read_npy(data: bytes, limits: ArrayLimits) -> _Floats:
    """The array of an .npy file as float64, of any number of dimensions. Raises Unsound."""
    try:
        return _array(io.BytesIO(data), limits)
    except _DAMAGE as err:
        raise _damaged(err) from err


def list_members(data: bytes) -> tuple[str, ...]:
    """Names of the arrays in an .npz file. Raises Unsound."""
    try:
        with _archive(data) as archive:
            return tuple(_names(archive))
    except _DAMAGE as err:
        raise _damaged(err) from err


def read_npz(data: bytes, wanted: Mapping[str, ArrayLimits]) -> dict[str, _Floats]:
    """The wanted arrays of an .npz file by name, as float64. Raises Unsound."""
    try:
        with _archive(data) as archive:
            names = _names(archive)
            missing = [name for name in wanted if name not in names]
            if missing:
                raise UnsoundFileError(
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
    check_archive_end(data[-ARCHIVE_END_BYTES:])
    return zipfile.ZipFile(io.BytesIO(data))


def check_archive_end(tail: bytes) -> None:
    """Check the last `ARCHIVE_END_BYTES` of a zip archive before its directory is read, which may
    claim any size. Raises Unsound."""
    end = tail[-_END_BYTES:]
    if len(end) < _END_BYTES or end[:4] != _END or end[-2:] != b"\0\0":
        raise UnsoundFileError(
            "it is damaged: no .npz file ends like that", "write it with numpy.savez"
        )
    if tail[-ARCHIVE_END_BYTES:][:4] == _END_64:
        raise UnsoundFileError("it is a zip archive of a larger kind", "write it with numpy.savez")
    if int.from_bytes(end[12:16], "little") > MAX_DIRECTORY_BYTES:
        raise UnsoundFileError("it holds too many files", f"store at most {_MAX_MEMBERS} arrays")


def _names(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    listed = archive.infolist()
    if not 0 < len(listed) <= _MAX_MEMBERS:
        raise UnsoundFileError(
            f"it holds {len(listed)} arrays", f"store one to {_MAX_MEMBERS} with numpy.savez"
        )
    for info in listed:
        plain = info.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        if not plain or info.flag_bits & 1:
            raise UnsoundFileError(
                "it is packed or locked in a way that is not read", "use numpy.savez"
            )
    return {info.filename.removesuffix(".npy"): info for info in listed}


def _member(name: str, stream: IO[bytes], limits: ArrayLimits) -> _Floats:
    try:
        return _array(stream, limits)
    except UnsoundFileError as err:
        raise UnsoundFileError(f"`{name}`: {err.message}", err.hint) from err
    except _DAMAGE as err:
        raise UnsoundFileError(f"`{name}`: {_damaged(err).message}", _damaged(err).hint) from err


def _array(stream: IO[bytes], limits: ArrayLimits) -> _Floats:
    dtype, fortran, shape = _header(stream)
    size = limits.check(shape) * dtype.itemsize
    flat = np.frombuffer(_exactly(stream, size, limits), dtype=dtype)
    with np.errstate(over="ignore"):  # values beyond float64 become infinite, and are refused
        array = flat.reshape(shape, order="F" if fortran else "C").astype(np.float64, order="C")
    check_finite(array)
    return array


def _header(stream: IO[bytes]) -> tuple[np.dtype[Any], bool, tuple[int, ...]]:
    """Type, order and shape. The header is matched, not evaluated as numpy does it, in time linear
    in its length: no other thread can run while a regular expression matches."""
    start = stream.read(8)
    version = (start[6], start[7]) if len(start) == 8 and start.startswith(_NPY_MAGIC) else None
    if version not in ((1, 0), (2, 0)):
        raise UnsoundFileError(
            "it is no .npy file of version 1.0 or 2.0", "write it with numpy.save"
        )
    length = int.from_bytes(stream.read(2 * version[0]), "little")
    if length > _MAX_HEADER:
        raise UnsoundFileError(f"its header has {length} characters", "write it with numpy.save")
    text = " ".join(_WORD.findall(stream.read(length).decode("latin-1")))
    found = dict(_ITEM.findall(text)) if _HEADER.fullmatch(text) else {}
    if found.keys() != {"descr", "fortran_order", "shape"}:
        raise UnsoundFileError("its header is not that of real numbers", "store real numbers")
    dtype = np.dtype(found["descr"].strip("'\""))
    if dtype.kind not in "biuf":
        raise UnsoundFileError(f"it holds {dtype}, not real numbers", "store real numbers")
    shape = tuple(int(side) for side in re.findall(r"\d+", found["shape"]))
    return dtype, found["fortran_order"] == "True", shape


def check_finite(array: _Floats) -> None:
    """Raise Unsound for infinite values and NaN, which mean nothing to any goal."""
    finite = np.isfinite(array)
    if not finite.all():
        first = ", ".join(map(str, np.argwhere(~finite)[0]))
        raise UnsoundFileError(
            f"it has {finite.size - np.count_nonzero(finite)} values that are not finite, the "
            f"first at ({first})",
            "replace NaN and infinity by numbers",
        )


def _exactly(stream: IO[bytes], size: int, limits: ArrayLimits) -> bytearray:
    """Exactly `size` bytes; memory is taken only as they come."""
    data = bytearray()
    for piece in _pieces(stream, size):
        limits.alive()
        data += piece
    if len(data) < size:
        raise UnsoundFileError(f"it ends after {len(data)} of {size} bytes", "write it again")
    if stream.read(1):
        raise UnsoundFileError("more bytes follow than its shape tells", "write it again")
    return data


def _pieces(stream: IO[bytes], size: int) -> Iterator[bytes]:
    while size > 0 and (piece := stream.read(min(READ_CHUNK_BYTES, size))):
        size -= len(piece)
        yield piece


def _damaged(err: BaseException) -> UnsoundFileError:
    why = " ".join(str(err).split())[:120] or type(err).__name__
    return UnsoundFileError(
        f"it is damaged: {why}", "write it again with numpy.save or numpy.savez"
    )


PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
MAX_PIXELS = 2**24
"""Most pixels of a picture, whatever the limit of elements."""

_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Samples of a pixel by colour type."""
_KEPT = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")


def _read_png(data: bytes, limits: ArrayLimits) -> _Floats:
    """A picture as grey values, (rows, columns) float64, full scale 1. Raises Unsound.

    Colours become grey with OpenCV's weights; transparency is ignored.
    """
    chunks = [(kind, body) for kind, body in _chunks(data) if kind in _KEPT]
    if not chunks or chunks[0][0] != b"IHDR" or len(chunks[0][1]) != 13:
        raise UnsoundFileError("it is damaged: a PNG file begins otherwise")
    width, height, depth, colour, packing, filters, interlace = struct.unpack(
        ">IIBBBBB", chunks[0][1]
    )
    if colour not in _CHANNELS or depth not in (1, 2, 4, 8, 16) or packing or filters:
        raise UnsoundFileError("it is damaged: there is no such PNG file")
    if interlace:
        raise UnsoundFileError("it is an interlaced PNG file", "save it without interlacing")
    ArrayLimits(min(limits.elements, MAX_PIXELS)).check((height, width))
    row_bytes = 1 + (width * _CHANNELS[colour] * depth + 7) // 8
    _check_pixels(b"".join(body for kind, body in chunks if kind == b"IDAT"), height * row_bytes)
    limits.alive()
    image = _decoded(PNG_MAGIC + b"".join(_packed(kind, body) for kind, body in chunks))
    if image is None or image.shape != (height, width):
        raise UnsoundFileError("it is damaged: it cannot be decoded")
    full = {"uint8": 255.0, "uint16": 65535.0}[str(image.dtype)]
    return np.asarray(image.astype(np.float64) / full)


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and body of each chunk up to the end of the picture, with checksums verified."""
    at = len(PNG_MAGIC)
    while True:
        head = data[at : at + 8]
        if len(head) < 8:
            raise UnsoundFileError("it is damaged: it ends too early")
        length, kind = int.from_bytes(head[:4], "big"), head[4:]
        body, check = data[at + 8 : at + 8 + length], data[at + 8 + length : at + 12 + length]
        if len(body) < length or len(check) < 4:
            raise UnsoundFileError("it is damaged: it ends too early")
        if zlib.crc32(kind + body) != int.from_bytes(check, "big"):
            raise UnsoundFileError("it is damaged: a checksum is wrong")
        yield kind, body
        if kind == b"IEND":
            return
        at += 12 + length


def _check_pixels(packed: bytes, size: int) -> None:
    """Refuse a picture with fewer or more pixels than its header says."""
    unpack = zlib.decompressobj()
    try:
        # At most one byte too many is unpacked, however long the pixels are.
        found = len(unpack.decompress(packed, size + 1))
    except zlib.error as err:
        raise UnsoundFileError(f"it is damaged: {err}") from err
    if found != size:
        raise UnsoundFileError(f"it is damaged: its pixels take {size} bytes, {found} are there")


def _packed(kind: bytes, body: bytes) -> bytes:
    check = zlib.crc32(kind + body).to_bytes(4, "big")
    return len(body).to_bytes(4, "big") + kind + body + check


def _decoded(data: bytes) -> NDArray[np.generic] | None:
    import cv2  # most callers read no pictures

    try:
        return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_ANYDEPTH)
    except cv2.error:
        return None


def read_array(data: bytes, name: str, limits: ArrayLimits) -> _Floats:
    """A two-dimensional array of finite numbers, (rows, columns) float64.

    Accepts .npy, .npz with a single array or one of that `name`, and PNG: grey, full scale 1.
    Raises Unsound.
    """
    if data.startswith(PNG_MAGIC):
        return _read_png(data, limits)
    if data.startswith(_NPY_MAGIC):
        array = read_npy(data, limits)
    elif data.startswith(ZIP_MAGIC):
        held = list_members(data)
        if name not in held and len(held) != 1:
            raise UnsoundFileError(
                f"it holds {len(held)} arrays, none of which is called {name}",
                f"store it as {name} with numpy.savez",
            )
        (array,) = read_npz(data, {name if name in held else held[0]: limits}).values()
    else:
        raise UnsoundFileError(
            "it is neither .npy nor .npz nor PNG",
            "pictures of other kinds are not read: convert them to PNG, or use numpy.save",
        )
    if array.ndim != 2:
        raise UnsoundFileError(f"it has {array.ndim} dimensions, not 2", "give rows and columns")
    return array
