"""Image files of a run folder: TIFF of float32, laid out byte by byte as libtiff does, and PNG; and
JPEGs of a finder.

Float values are linear and are read back exactly, including negative ones and NaN. When a run is
decoded again, its files are compared by their hashes, so they must not depend on the library that
wrote them. `pdcd.pictures.written.export` makes files for other programs.
"""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

_STRIP_BYTES = 8192
"""A strip has as many rows as fit into this many bytes, at least one."""
_SHORT, _LONG = 3, 4
_SIZES = {_SHORT: 2, _LONG: 4}
_GREY, _RGB, _FLOAT = 1, 2, 3
_UNCOMPRESSED, _INTERLEAVED = 1, 1
_HEADER_BYTES = 8
_JPEG_QUALITY = 85
_MOST_JPEG_PX = 4096
"""Longest side of a JPEG that is decoded; JPEGs of finders are far smaller, but headers may claim
anything."""


def make_tiff_ends(image: NDArray[np.float32]) -> tuple[bytes, bytes]:
    """The bytes of a file before and after the numbers of a picture, (h, w, 1 or 3) float32."""
    height, width, channels = image.shape
    row_bytes = width * channels * 4
    rows = min(max(_STRIP_BYTES // row_bytes, 1), height)
    starts = np.arange(0, height, rows)
    sizes = np.minimum(height - starts, rows) * row_bytes
    offsets = _HEADER_BYTES + starts * row_bytes
    end = _HEADER_BYTES + height * row_bytes
    short = sizes.size > 1 and int(sizes.max()) < 2**16
    entries: list[tuple[int, int, list[int]]] = [
        (256, _SHORT if width < 2**16 else _LONG, [width]),
        (257, _SHORT if height < 2**16 else _LONG, [height]),
        (258, _SHORT, [32] * channels),
        (259, _SHORT, [_UNCOMPRESSED]),
        (262, _SHORT, [_RGB if channels == 3 else _GREY]),
        (273, _LONG, offsets.tolist()),
        (277, _SHORT, [channels]),
        (278, _SHORT if rows < 2**16 else _LONG, [rows]),
        (279, _SHORT if short else _LONG, sizes.tolist()),
        (284, _SHORT, [_INTERLEAVED]),
        (339, _SHORT, [_FLOAT] * channels),
    ]
    return b"II*\0" + struct.pack("<I", end), _directory(entries, end)


def _directory(entries: list[tuple[int, int, list[int]]], start: int) -> bytes:
    """The directory at `start`, followed by the values that do not fit into its entries."""
    behind = start + 2 + 12 * len(entries) + 4
    fields, values = {}, b""
    # libtiff writes the sizes of strips before their offsets.
    for tag, kind, numbers in sorted(entries, key=lambda entry: (entry[0] == 339, entry[0] == 273)):
        data = np.array(numbers, f"<u{_SIZES[kind]}").tobytes()
        if len(data) > 4:
            values += b"\0" * (len(values) % 2)
            field, values = struct.pack("<I", behind + len(values)), values + data
        else:
            field = data.ljust(4, b"\0")
        fields[tag] = struct.pack("<HHI", tag, kind, len(numbers)) + field
    listed = b"".join(fields[tag] for tag, _, _ in entries)
    return struct.pack("<H", len(entries)) + listed + bytes(4) + values


def encode_png(picture: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """An (H, W, 3) RGB or (H, W, 1) grey picture as a PNG file of the same number of bits."""
    _, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
    return data.tobytes()


def encode_jpeg(picture: NDArray[np.uint8]) -> bytes:
    """An (H, W) grey or (H, W, 3) RGB picture as a JPEG, for display."""
    shown = picture if picture.ndim == 2 else np.ascontiguousarray(picture[..., ::-1])
    return cv2.imencode(".jpg", shown, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))[1].tobytes()


def decode_jpeg(data: bytes) -> NDArray[np.uint8] | None:
    """The (H, W, 3) RGB picture in a JPEG that a device sent; None if it is not a JPEG, or larger
    than any finder's. For drivers."""
    if not data.startswith(b"\xff\xd8") or not 0 < _read_jpeg_side(data) <= _MOST_JPEG_PX:
        return None
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        return None
    return None if picture is None else np.ascontiguousarray(picture[..., ::-1], np.uint8)


def _read_jpeg_side(data: bytes) -> int:
    """The longer side in a JPEG's frame header; 0 where there is no header (ITU T.81, B.1)."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        kind = data[at + 1]
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            height, width = data[at + 5 : at + 7], data[at + 7 : at + 9]
            return max(int.from_bytes(height), int.from_bytes(width))
        at += 1 if kind == 0xFF else 2 + struct.unpack_from(">H", data, at + 2)[0]
    return 0
