"""Image files of a run folder: TIFF of float32, laid out byte by byte as libtiff does, and PNG.

Float values are linear and come back exactly, negative ones and NaN as well. Files are compared by
their hashes when a run is decoded again, so that a run's pictures must not depend on who wrote
them. Files for other programs are made by `pdcd.pictures.written.export`.
"""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

_STRIP_BYTES = 8192
"""A strip has as many rows as fit into that, at least one."""
_SHORT, _LONG = 3, 4
_SIZES = {_SHORT: 2, _LONG: 4}
_RGB, _FLOAT = 2, 3
_UNCOMPRESSED, _INTERLEAVED = 1, 1
_HEADER_BYTES = 8


def make_tiff_ends(image: NDArray[np.float32]) -> tuple[bytes, bytes]:
    """What a file has before and after the numbers of an (h, w, 3) float32 picture."""
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
        (262, _SHORT, [_RGB]),
        (273, _LONG, offsets.tolist()),
        (277, _SHORT, [channels]),
        (278, _SHORT if rows < 2**16 else _LONG, [rows]),
        (279, _SHORT if short else _LONG, sizes.tolist()),
        (284, _SHORT, [_INTERLEAVED]),
        (339, _SHORT, [_FLOAT] * channels),
    ]
    return b"II*\0" + struct.pack("<I", end), _directory(entries, end)


def _directory(entries: list[tuple[int, int, list[int]]], start: int) -> bytes:
    """The directory at `start`, and behind it what does not fit into its entries."""
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
    """An (H, W, 3) RGB picture as the content of a PNG file of as many bits a colour."""
    _, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
    return data.tobytes()
