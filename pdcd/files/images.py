"""Image files that a run folder or an export writes, made here byte by byte: TIFF of float32, laid
out as libtiff does; TIFF and PNG of 16 bits a colour; OpenEXR of one part, scan lines in blocks of
16, compressed by ZIP as the specification of the format has it (OpenEXR File Layout).

All are linear, and what is known of a picture is in them as text. Float values come back exactly,
negative ones and NaN as well. Files are compared by their hashes when a run is decoded again, so
that a run's pictures must not depend on who wrote them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

STRIP_BYTES = 8192
"""A strip has as many rows as fit into that, at least one."""
_SHORT, _LONG = 3, 4
_SIZES = {_SHORT: 2, _LONG: 4}
_RGB, _FLOAT = 2, 3
_UNCOMPRESSED, _INTERLEAVED = 1, 1
_HEADER_BYTES = 8


def around(image: NDArray[np.float32]) -> tuple[bytes, bytes]:
    """What a file has before and after the numbers of an (h, w, 3) float32 picture."""
    height, width, channels = image.shape
    row_bytes = width * channels * 4
    rows = min(max(STRIP_BYTES // row_bytes, 1), height)
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


MAGIC, VERSION = 20000630, 2
ZIP, BLOCK_LINES = 3, 16
FLOAT = 2
LEVEL = 4
"""Of the compression: more takes far longer and gains little."""


def exr_bytes(image: NDArray[np.float32], told: Mapping[str, str]) -> bytes:
    """A picture as the bytes of a file.

    image : (h, w, 3) float32, linear RGB; told : attributes, names of up to 31 ASCII letters.
    """
    height, width, _ = image.shape
    # Channels lie in the order of their names, line by line.
    lines = np.ascontiguousarray(image[..., ::-1].swapaxes(1, 2), dtype="<f4")
    blocks = [_packed(lines[y : y + BLOCK_LINES].tobytes()) for y in range(0, height, BLOCK_LINES)]
    head = struct.pack("<ii", MAGIC, VERSION) + b"".join(_header(width, height, told)) + b"\0"
    at, offsets, body = len(head) + 8 * len(blocks), [], []
    for number, block in enumerate(blocks):
        offsets.append(at)
        body.append(struct.pack("<ii", number * BLOCK_LINES, len(block)) + block)
        at += len(body[-1])
    return b"".join([head, struct.pack(f"<{len(offsets)}Q", *offsets), *body])


def _header(width: int, height: int, told: Mapping[str, str]) -> Iterator[bytes]:
    channels = b"".join(
        name + b"\0" + struct.pack("<iB3xii", FLOAT, 0, 1, 1) for name in (b"B", b"G", b"R")
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    yield _attribute("channels", "chlist", channels + b"\0")
    yield _attribute("compression", "compression", bytes([ZIP]))
    yield _attribute("dataWindow", "box2i", window)
    yield _attribute("displayWindow", "box2i", window)
    yield _attribute("lineOrder", "lineOrder", b"\0")
    yield _attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0))
    yield _attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0))
    yield _attribute("screenWindowWidth", "float", struct.pack("<f", 1.0))
    for name, words in told.items():
        yield _attribute(name, "string", words.encode())


def _attribute(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


def _packed(raw: bytes) -> bytes:
    """A block of scan lines: bytes of even and odd places apart, as differences, deflated."""
    plain = np.frombuffer(raw, np.uint8)
    apart = np.concatenate([plain[0::2], plain[1::2]])
    steps = apart.copy()
    steps[1:] -= apart[:-1] + np.uint8(128)  # modulo 256, as the format wants it
    packed = zlib.compress(steps.tobytes(), LEVEL)
    return packed if len(packed) < len(raw) else raw
