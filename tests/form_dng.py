"""DNG files of any form, for tests of what reads them: written from the specification.

Both orders of bytes; whole numbers of 8 to 16 bits and real ones of 16, 24 and 32; strips and
tiles; plain, deflated and as lossless JPEG. Source: TIFF 6.0; Adobe DNG specification 1.4.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.cr2 import lossless_jpeg

BYTE, ASCII, SHORT, LONG, RATIONAL, UNDEFINED, SRATIONAL = 1, 2, 3, 4, 5, 7, 10
_CODES = {BYTE: "B", SHORT: "H", LONG: "I", RATIONAL: "II", UNDEFINED: "B", SRATIONAL: "ii"}
Tag = tuple[int, Sequence[int]]
"""Type and numbers; fractions as numerator, denominator, ..."""


@dataclass(frozen=True)
class DngFile:
    """What a file says; `samples` are those of the whole sensor, (H, W).

    black : rows of a pattern. down, across : of each row and column of the active area.
    active, masked : top, left, bottom, right. tile : rows and columns. more : tags that replace.
    """

    bits: int = 16
    floating: bool = False
    order: str = "<"
    black: Sequence[Sequence[float]] = ((256.0,),)
    down: Sequence[float] = ()
    across: Sequence[float] = ()
    white: int = 4095
    active: tuple[int, int, int, int] | None = None
    masked: Sequence[int] = ()
    cfa: Sequence[int] = (0, 1, 1, 2)
    strip_rows: int = 0
    tile: tuple[int, int] | None = None
    packing: int = 1
    predictor: int = 1
    table: Sequence[int] = ()
    more: Mapping[int, Tag] = field(default_factory=lambda: MappingProxyType({}))


def write_dng_form(path: Path, samples: NDArray[Any], file: DngFile) -> bytes:
    """Write such a file; returns its bytes."""
    height, width = samples.shape
    rows, columns = file.tile or (file.strip_rows or height, width)
    parts = []
    for top in range(0, height, rows):
        for left in range(0, width, columns):
            piece = samples[top : top + rows, left : left + columns]
            if file.tile:  # filled up at the edges
                wanted = (0, rows - piece.shape[0]), (0, columns - piece.shape[1])
                piece = np.pad(piece, wanted, mode="edge")
            parts.append(_packed(piece, file))
    tags = _tags(file, height, width, rows, columns)
    offsets, counts = (324, 325) if file.tile else (273, 279)
    tags[offsets] = (LONG, [0] * len(parts))
    tags[counts] = (LONG, [len(part) for part in parts])
    tags |= file.more
    at = 8 + len(_directory(tags, 8, file.order))
    places = []
    for part in parts:
        places.append(at)
        at += len(part)
    if offsets not in file.more:
        tags[offsets] = (LONG, places)
    order = b"II" if file.order == "<" else b"MM"
    head = order + struct.pack(f"{file.order}HI", 42, 8)
    data = head + _directory(tags, 8, file.order) + b"".join(parts)
    path.write_bytes(data)
    return data


def _tags(file: DngFile, height: int, width: int, rows: int, columns: int) -> dict[int, Tag]:
    def fractions(values: Sequence[float]) -> list[int]:
        exact = [Fraction(value).limit_denominator(1000) for value in values]
        return [n for value in exact for n in (value.numerator, value.denominator)]

    levels = [value for row in file.black for value in row]
    tags: dict[int, Tag] = {
        254: (LONG, [0]), 256: (LONG, [width]), 257: (LONG, [height]), 258: (SHORT, [file.bits]),
        259: (SHORT, [file.packing]), 262: (SHORT, [32803]), 271: (ASCII, list(b"Maker\0")),
        272: (ASCII, list(b"Model\0")), 277: (SHORT, [1]), 33421: (SHORT, [2, 2]),
        33422: (BYTE, file.cfa), 50706: (BYTE, [1, 4, 0, 0]), 50707: (BYTE, [1, 1, 0, 0]),
        50708: (ASCII, list(b"Maker Model\0")), 50713: (SHORT, [len(file.black),
        len(file.black[0])]), 50717: (LONG, [file.white]), 33437: (RATIONAL, [28, 10]),
    }  # fmt: skip
    if all(float(level).is_integer() for level in levels):
        tags[50714] = (LONG, [int(level) for level in levels])
    else:
        tags[50714] = (RATIONAL, fractions(levels))
    if file.floating:
        tags[339] = (SHORT, [3])
    if file.predictor != 1:
        tags[317] = (SHORT, [file.predictor])
    for tag, values in ((50716, file.down), (50715, file.across)):
        if values:
            tags[tag] = (SRATIONAL, fractions(values))
    if file.active:
        tags[50829] = (LONG, file.active)
    if file.masked:
        tags[50830] = (LONG, file.masked)
    if file.table:
        tags[50712] = (SHORT, file.table)
    if file.tile:
        tags |= {322: (LONG, [columns]), 323: (LONG, [rows])}
    else:
        tags[278] = (LONG, [rows])
    return tags


def _packed(part: NDArray[Any], file: DngFile) -> bytes:
    if file.packing == 7:
        return lossless_jpeg(part.astype(np.uint16))
    rows = [_row(row, file) for row in part.tolist()]
    if file.packing == 1:
        return b"".join(rows)
    return zlib.compress(b"".join(rows), 1)


def _row(values: list[Any], file: DngFile) -> bytes:
    size = file.bits // 8
    if file.floating:
        order = ">" if file.predictor != 1 else file.order
        each = [_real(value, size, order) for value in values]
        if file.predictor == 1:
            return b"".join(each)
        planes = bytes(one[byte] for byte in range(size) for one in each)
        step = {3: 1, 34894: 2, 34895: 4}[file.predictor]
        return bytes(
            (byte - (planes[n - step] if n >= step else 0)) & 0xFF for n, byte in enumerate(planes)
        )
    if file.bits in (8, 16):
        return struct.pack(f"{file.order}{len(values)}{'BH'[size - 1]}", *values)
    number = 0
    for value in values:
        number = number << file.bits | value
    spare = -len(values) * file.bits % 8
    return (number << spare).to_bytes((len(values) * file.bits + spare) // 8, "big")


def _real(value: float, size: int, order: str) -> bytes:
    if size != 3:
        return struct.pack(f"{order}{'e' if size == 2 else 'f'}", value)
    (word,) = struct.unpack(">I", struct.pack(">f", value))
    sign, exponent, mantissa = word >> 31, word >> 23 & 0xFF, word >> 7 & 0xFFFF
    short = sign << 23 | max(exponent - 64, 0) << 16 | mantissa if exponent > 64 else 0
    return short.to_bytes(3, "big" if order == ">" else "little")


def _directory(tags: Mapping[int, Tag], at: int, order: str) -> bytes:
    entries, values = struct.pack(f"{order}H", len(tags)), b""
    behind = at + 2 + 12 * len(tags) + 4
    for tag, (kind, numbers) in sorted(tags.items()):
        each = "B" if kind == ASCII else _CODES[kind]
        packed = struct.pack(f"{order}{len(numbers)}{each[0]}", *numbers)
        entries += struct.pack(f"{order}HHI", tag, kind, len(numbers) // len(each))
        if len(packed) <= 4:
            entries += packed.ljust(4, b"\0")
        else:
            entries += struct.pack(f"{order}I", behind + len(values))
            values += packed + b"\0" * (len(packed) % 2)
    return entries + bytes(4) + values
