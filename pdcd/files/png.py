"""Grey values of PNG files from bytes that nobody vouches for.

The file is taken apart first: its size, its checksums, the length of its pixels. Only what makes
the picture goes on to the decoder, so that no comment or colour profile reaches it. Other formats
are not read, because their size and their end cannot be told as surely before a C library sees
them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.files.limits import Limits, Unsound

Floats = NDArray[np.float64]

MAGIC = b"\x89PNG\r\n\x1a\n"
MAX_PIXELS = 2**24
"""Pixels of a picture, whatever the limit of elements is."""

_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Samples of a pixel by colour type."""
_KEPT = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")


def read_png(data: bytes, limits: Limits) -> Floats:
    """A picture as grey values, (rows, columns) float64, full scale 1. Raises Unsound.

    Colours become grey, as OpenCV weighs them; transparency is ignored.
    """
    chunks = [(kind, body) for kind, body in _chunks(data) if kind in _KEPT]
    if not chunks or chunks[0][0] != b"IHDR" or len(chunks[0][1]) != 13:
        raise Unsound("it is damaged: a PNG file begins otherwise")
    width, height, depth, colour, packing, filters, interlace = struct.unpack(
        ">IIBBBBB", chunks[0][1]
    )
    if colour not in _CHANNELS or depth not in (1, 2, 4, 8, 16) or packing or filters:
        raise Unsound("it is damaged: there is no such PNG file")
    if interlace:
        raise Unsound("it is an interlaced PNG file", "save it without interlacing")
    Limits(min(limits.elements, MAX_PIXELS)).check((height, width))
    row_bytes = 1 + (width * _CHANNELS[colour] * depth + 7) // 8
    _check_pixels(b"".join(body for kind, body in chunks if kind == b"IDAT"), height * row_bytes)
    limits.alive()
    image = _decoded(MAGIC + b"".join(_packed(kind, body) for kind, body in chunks))
    if image is None or image.shape != (height, width):
        raise Unsound("it is damaged: it cannot be decoded")
    full = {"uint8": 255.0, "uint16": 65535.0}[str(image.dtype)]
    return np.asarray(image.astype(np.float64) / full)


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and body of each chunk up to the end of the picture, checksums proven."""
    at = len(MAGIC)
    while True:
        head = data[at : at + 8]
        if len(head) < 8:
            raise Unsound("it is damaged: it ends too early")
        length, kind = int.from_bytes(head[:4], "big"), head[4:]
        body, check = data[at + 8 : at + 8 + length], data[at + 8 + length : at + 12 + length]
        if len(body) < length or len(check) < 4:
            raise Unsound("it is damaged: it ends too early")
        if zlib.crc32(kind + body) != int.from_bytes(check, "big"):
            raise Unsound("it is damaged: a checksum is wrong")
        yield kind, body
        if kind == b"IEND":
            return
        at += 12 + length


def _check_pixels(packed: bytes, size: int) -> None:
    """Refuse a picture with fewer or more pixels than its header tells."""
    unpack = zlib.decompressobj()
    try:
        # One byte more than there may be, so that nothing is unpacked for the sake of its size.
        found = len(unpack.decompress(packed, size + 1))
    except zlib.error as err:
        raise Unsound(f"it is damaged: {err}") from err
    if found != size:
        raise Unsound(f"it is damaged: its pixels take {size} bytes, {found} are there")


def _packed(kind: bytes, body: bytes) -> bytes:
    check = zlib.crc32(kind + body).to_bytes(4, "big")
    return len(body).to_bytes(4, "big") + kind + body + check


def _decoded(data: bytes) -> NDArray[np.generic] | None:
    try:
        return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_ANYDEPTH)
    except cv2.error:
        return None
