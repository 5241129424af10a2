"""CR2 files for tests: Canon's container around losslessly compressed samples.

Written from the public description of the format (TIFF 6.0, ITU-T T.81 annex H, the tag CR2Slice)
because no file of a real camera can be had here. LibRaw and dcraw take it for a picture of an EOS
450D: they decode it by the same code, and know the masked border from the size of the sensor. Not
modelled: maker notes, previews, white balance.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SIZE_450D = (2876, 4312)
"""Rows and columns of the whole sensor."""
TOP_450D, LEFT_450D = 18, 22
"""Masked rows and columns, by the tables of dcraw and LibRaw."""
BITS = 14
_CHUNK = 1 << 16
"""Samples packed at a time: so many fit the processor's cache."""
_ASCII, _SHORT, _LONG, _RATIONAL = 2, 3, 4, 5
_Field = tuple[int, int, bytes]


def write_cr2(
    path: Path,
    sensor: NDArray[np.uint16],
    *,
    iso: int = 100,
    exposure: tuple[int, int] = (6, 10),
    orientation: int = 1,
    model: str = "Canon EOS 450D",
    date: str = "2024:02:29 23:59:58",
) -> int:
    """Write all samples of a sensor, masked borders included; returns the bytes written.

    sensor : (H, W) uint16, below 2^14, W a multiple of 4. Stored in two slices of half the width,
    as two components side by side.
    """
    jpeg = lossless_jpeg(sliced(sensor))
    exif = {
        33434: (_RATIONAL, 1, struct.pack("<II", *exposure)),
        34855: (_SHORT, 1, struct.pack("<H", iso)),
        36867: _text(date),
    }
    first = {
        271: _text("Canon"),
        272: _text(model),
        274: (_SHORT, 1, struct.pack("<H", orientation)),
        306: _text(date),
        34665: (_LONG, 1, b""),
    }
    half = sensor.shape[1] // 2
    raw = {
        259: (_SHORT, 1, struct.pack("<H", 6)),
        273: (_LONG, 1, b""),
        279: (_LONG, 1, struct.pack("<I", len(jpeg))),
        50752: (_SHORT, 3, struct.pack("<3H", 1, half, half)),  # CR2Slice
    }
    first_at = 16
    exif_at = first_at + len(_directory(first, 0, 0))
    raw_at = exif_at + len(_directory(exif, 0, 0))
    data_at = raw_at + len(_directory(raw, 0, 0))
    first[34665] = (_LONG, 1, struct.pack("<I", exif_at))
    raw[273] = (_LONG, 1, struct.pack("<I", data_at))
    parts = [
        struct.pack("<2sHI2sBBI", b"II", 42, first_at, b"CR", 2, 0, raw_at),
        _directory(first, first_at, raw_at),
        _directory(exif, exif_at, 0),
        _directory(raw, raw_at, 0),
        jpeg,
    ]
    return path.write_bytes(b"".join(parts))


def sliced(sensor: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The samples in the order of the JPEG, (H, W): all of the left slice, then of the right."""
    height, width = sensor.shape
    left, right = sensor[:, : width // 2], sensor[:, width // 2 :]
    return np.concatenate([left.ravel(), right.ravel()]).reshape(height, width)


def lossless_jpeg(image: NDArray[np.uint16]) -> bytes:
    """Lossless JPEG of two interleaved components, predictor 1 (the sample to the left).

    Every size class of a difference has a code of 4 bits, so that no table need be fitted.
    """
    height, width = image.shape
    samples = image.astype(np.int16).reshape(height, width // 2, 2)
    difference = np.empty_like(samples)
    difference[:, 1:] = samples[:, 1:] - samples[:, :-1]
    difference[1:, 0] = samples[1:, 0] - samples[:-1, 0]
    difference[0, 0] = samples[0, 0] - (1 << (BITS - 1))
    stream = _packed(difference.ravel()).replace(b"\xff", b"\xff\x00")
    classes = bytes(range(15))
    return b"".join(
        [
            b"\xff\xd8",
            _segment(0xC4, b"\x00" + bytes([0, 0, 0, len(classes)]) + bytes(12) + classes),
            _segment(
                0xC3,
                struct.pack(">BHHB", BITS, height, width // 2, 2) + b"\x01\x11\x00\x02\x11\x00",
            ),
            _segment(0xDA, b"\x02\x01\x00\x02\x00\x01\x00\x00"),
            stream,
            b"\xff\xd9",
        ]
    )


def _packed(differences: NDArray[np.int16]) -> bytes:
    """4 bits for the size class of each difference and as many as its size for itself."""
    sizes = np.frexp(np.arange(1 << BITS))[1].astype(np.uint8)
    total = 0
    words = np.zeros(differences.size * (4 + BITS) // 64 + 2, dtype=np.uint64)
    for start in range(0, differences.size, _CHUNK):
        part = differences[start : start + _CHUNK].astype(np.int64)
        size = sizes[np.abs(part)].astype(np.int64)
        bits = (size << size | np.where(part < 0, part + (1 << size) - 1, part)).astype(np.uint64)
        ends = total + np.cumsum(4 + size)
        at = ends - 4 - size
        word, room = at >> 6, 64 - (ends - (at & ~63))
        shift = np.abs(room).astype(np.uint64)
        whole = np.where(room >= 0, bits << shift, bits >> shift)
        first = np.flatnonzero(np.diff(word, prepend=-1))
        words[word[first]] |= np.bitwise_or.reduceat(whole, first)
        torn = np.flatnonzero(room < 0)
        words[word[torn] + 1] |= bits[torn] << (64 - shift[torn])
        total = int(ends[-1])
    spare = -total % 8  # filled up with ones
    if spare:
        words[total // 64] |= np.uint64(((1 << spare) - 1) << (64 - total % 64 - spare))
    return words.astype(">u8").tobytes()[: (total + spare) // 8]


def _segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


def _text(text: str) -> _Field:
    return _ASCII, len(text) + 1, text.encode("ascii") + b"\0"


def _directory(fields: dict[int, _Field], at: int, following: int) -> bytes:
    """One TIFF directory at an offset, its long values behind it."""
    entries: Sequence[tuple[int, _Field]] = sorted(fields.items())
    head, tail = struct.pack("<H", len(entries)), b""
    behind = at + 2 + 12 * len(entries) + 4
    for tag, (kind, count, value) in entries:
        head += struct.pack("<HHI", tag, kind, count)
        if len(value) <= 4:
            head += value.ljust(4, b"\0")
        else:
            head += struct.pack("<I", behind + len(tail))
            tail += value + b"\0" * (len(value) % 2)
    return head + struct.pack("<I", following) + tail
