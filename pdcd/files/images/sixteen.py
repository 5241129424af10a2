"""TIFF and PNG files of 16 bits a colour, linear, with what is known of them as text."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint16]

_ASCII, _SHORT, _LONG, _RATIONAL = 2, 3, 4, 5
_PACKING = {_SHORT: "H", _LONG: "I", _RATIONAL: "I"}
_NUMBERS = {_SHORT: 1, _LONG: 1, _RATIONAL: 2}
"""Of one value."""


def png_of(picture: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """An (H, W, 3) RGB picture as the content of a PNG file of as many bits a colour."""
    _, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
    return data.tobytes()


def tiff_bytes(image: Words, told: Mapping[str, str], software: str) -> bytes:
    """A picture (h, w, 3) uint16 as an uncompressed TIFF file of one strip.

    `told` becomes the ImageDescription, a line for each. All text is ASCII.
    """
    height, width, _ = image.shape
    lines = "\n".join(f"{name}: {words}" for name, words in told.items())
    data = image.astype("<u2").tobytes()
    fields = (
        (256, _LONG, (width,)),
        (257, _LONG, (height,)),
        (258, _SHORT, (16, 16, 16)),
        (259, _SHORT, (1,)),  # no compression
        (262, _SHORT, (2,)),  # RGB
        (270, _ASCII, lines),
        (273, _LONG, (8,)),
        (274, _SHORT, (1,)),  # first row on top
        (277, _SHORT, (3,)),
        (278, _LONG, (height,)),
        (279, _LONG, (len(data),)),
        (282, _RATIONAL, (1, 1)),
        (283, _RATIONAL, (1, 1)),
        (284, _SHORT, (1,)),  # colours of a pixel side by side
        (296, _SHORT, (1,)),  # resolution in no unit
        (305, _ASCII, software),
    )
    begin = 8 + len(data)  # even, as the format wants it: samples have two bytes
    more_at, entries, more = begin + 2 + 12 * len(fields) + 4, b"", b""
    for tag, kind, value in fields:
        packed, count = _value(kind, value)
        entries += struct.pack("<HHI", tag, kind, count)
        if len(packed) <= 4:
            entries += packed.ljust(4, b"\0")
        else:
            entries += struct.pack("<I", more_at + len(more))
            more += packed + b"\0" * (len(packed) % 2)
    head = struct.pack("<2sHI", b"II", 42, begin)
    directory = struct.pack("<H", len(fields)) + entries + struct.pack("<I", 0)
    return head + data + directory + more


def _value(kind: int, value: str | tuple[int, ...]) -> tuple[bytes, int]:
    """The bytes of a field, and how many values they are."""
    if isinstance(value, str):
        text = value.encode("ascii", "backslashreplace") + b"\0"
        return text, len(text)
    packed = struct.pack(f"<{len(value)}{_PACKING[kind]}", *value)
    return packed, len(value) // _NUMBERS[kind]


def png_bytes(image: Words, told: Mapping[str, str], software: str) -> bytes:
    """A picture (h, w, 3) uint16 as a PNG file; a gAMA chunk says that it is linear.

    Each line of `told` becomes a tEXt chunk. All text is ASCII.
    """
    data = png_of(image)
    after_header = 8 + 12 + 13
    chunks = _chunk(b"gAMA", struct.pack(">I", 100_000))
    for name, words in {**told, "Software": software}.items():
        text = words.encode("ascii", "backslashreplace")
        chunks += _chunk(b"tEXt", name.encode("ascii") + b"\0" + text)
    return data[:after_header] + chunks + data[after_header:]


def _chunk(kind: bytes, body: bytes) -> bytes:
    check = struct.pack(">I", zlib.crc32(kind + body))
    return struct.pack(">I", len(body)) + kind + body + check
