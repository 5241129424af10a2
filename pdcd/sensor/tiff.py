"""The tags of a file built on TIFF: DNG, CR2, NEF, ARW, and RW2 and ORF, whose first bytes differ.

LibRaw's Python binding leaves out the camera's name, the date and the masked borders, and it cannot
tell a file that is still being written from a damaged one. Source: TIFF 6.0, section 2;
Adobe DNG specification 1.4, chapter 4.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import cast

_ORDERS = {
    b"II*\0": "<",
    b"MM\0*": ">",
    b"IIU\0": "<",  # Panasonic's RW2
    b"IIRO": "<",  # Olympus' ORF, three kinds
    b"IIRS": "<",
    b"MMOR": ">",
}
MODEL, _EXIF, _SUB = 272, 34665, 330
DATE_TAKEN, MASKED_AREAS, EXPOSURE_TIME, F_NUMBER = 36867, 50830, 33434, 33437
ISO = 34855
SUBFILE_TYPE, IMAGE_WIDTH, IMAGE_LENGTH = 254, 256, 257
BITS, COMPRESSION, PHOTOMETRIC = 258, 259, 262
STRIP_OFFSETS, SAMPLES_PER_PIXEL, ROWS_PER_STRIP, STRIP_BYTES = 273, 277, 278, 279
FILL_ORDER, PREDICTOR, SAMPLE_FORMAT = 266, 317, 339
TILE_WIDTH, TILE_LENGTH, TILE_OFFSETS, TILE_BYTES = 322, 323, 324, 325
CFA_DIM, CFA_PATTERN, CFA_LAYOUT, ACTIVE_AREA = 33421, 33422, 50711, 50829
DNG_VERSION, LINEARIZATION, CANON_SLICES = 50706, 50712, 50752
INTERLEAVES = 50974, 50975, 52547
"""Tags of a DNG whose blocks, rows or columns are stored in another order."""
RW2_WIDTH, RW2_HEIGHT, RW2_BITS, RW2_FORMAT, RW2_DATA = 2, 3, 10, 45, 280
BLACK_DIM, BLACK_LEVEL, WHITE_LEVEL = 50713, 50714, 50717
BLACK_DELTA_H, BLACK_DELTA_V = 50715, 50716
OPCODES = 51008
"""OpcodeList1: operations on the samples as stored. Only the numbers of the opcodes are kept."""
_DATA = ((273, 279), (324, 325), (513, 514))  # offsets and lengths of strips, tiles, a preview
_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
_NUMBERS = {1: "B", 3: "H", 4: "I", 5: "II", 13: "I"}
_REALS = _NUMBERS | {6: "b", 8: "h", 9: "i", 10: "ii", 11: "f", 12: "d"}
_LEVELS = frozenset({BLACK_LEVEL, BLACK_DELTA_H, BLACK_DELTA_V, WHITE_LEVEL, F_NUMBER})
"""Tags that may be fractions; kept as real numbers, NaN for one without a denominator."""
_ASCII, _UNDEFINED = 2, 7
_MOST_OPCODES = 64
"""Most opcodes of a list that are read; real lists have fewer than ten."""
_MAX_DIRECTORIES = 64
"""Most directories that are read: real files have fewer than ten, a damaged one may chain them
without end."""
_MOST_ENTRIES, _MOST_NUMBERS = 2**10, 2**20
"""Most entries of a directory, and most numbers in all tags that are kept. Real directories have
some hundred entries, and the places and lengths of some thousand strips. A file that claims more
could take hours or gigabytes to read, as all entries may point to the same bytes."""
_NOWHERE = 0xFFFFFFFF
"""A place that is given by another tag."""
_RW2 = b"IIU\0"
"""First bytes of files whose lengths of strips need not be true."""
_KEPT = {
    MODEL, _EXIF, _SUB, DATE_TAKEN, MASKED_AREAS, EXPOSURE_TIME, ISO, SUBFILE_TYPE, IMAGE_WIDTH,
    IMAGE_LENGTH, BITS, COMPRESSION, PHOTOMETRIC, SAMPLES_PER_PIXEL, ROWS_PER_STRIP, FILL_ORDER,
    PREDICTOR, SAMPLE_FORMAT, TILE_WIDTH, TILE_LENGTH, CFA_DIM, CFA_PATTERN, CFA_LAYOUT,
    ACTIVE_AREA, DNG_VERSION, LINEARIZATION, CANON_SLICES, BLACK_DIM, RW2_WIDTH, RW2_HEIGHT,
    RW2_BITS, RW2_FORMAT, RW2_DATA, OPCODES,
}.union(*_DATA, _LEVELS, INTERLEAVES)  # fmt: skip

_Values = tuple[int, ...] | tuple[float, ...] | str
TiffDirectory = dict[int, _Values]
"""Numbers or text of the tags of one directory."""


@dataclass(frozen=True)
class TiffTags:
    """Tags of all directories of a file.

    directories : numbers or text of each tag this module knows, one dictionary a directory.
    needs_bytes : where the data that the directories refer to end. A shorter file is not whole; if
        a directory lies beyond the end, this is one byte more than the file has.
    canon : whether it is a CR2.
    order : byte order of numbers, "<" or ">".
    """

    directories: tuple[TiffDirectory, ...]
    needs_bytes: int
    canon: bool
    order: str = "<"

    def text(self, tag: int) -> str:
        """The first text under a tag, "" when there is none."""
        return next((v for d in self.directories if isinstance(v := d.get(tag), str)), "")

    def numbers(self, tag: int) -> tuple[int, ...]:
        """The first whole numbers under a tag, empty when there are none."""
        return next((found for d in self.directories if (found := read_numbers(d, tag))), ())

    @property
    def f_number(self) -> float | None:
        """The stop that the camera gives; None where it gives none, or no valid number."""
        for directory in self.directories:
            if said := read_reals(directory, F_NUMBER):
                return said[0] if math.isfinite(said[0]) and said[0] > 0.0 else None
        return None

    @property
    def says_f_number(self) -> bool:
        """Whether there is a tag for the stop, whatever its value."""
        return any(F_NUMBER in directory for directory in self.directories)

    @property
    def exposure_s(self) -> float:
        """The exposure time that the camera gives; 0 where it gives none."""
        said = self.numbers(EXPOSURE_TIME)
        return said[0] / said[1] if len(said) == 2 and said[1] else 0.0


def read_tags(data: bytes) -> TiffTags | None:
    """The tags of a file's bytes; None for a file that does not begin like TIFF. Never raises."""
    order = _ORDERS.get(data[:4])
    if order is None:
        return None
    canon = data[8:10] == b"CR"
    found: list[TiffDirectory] = []
    needs = 8
    # Where a directory is, and whether another one may follow it. None follows a directory below
    # another one; some cameras leave anything in that place.
    ahead = [(_number(order, data, 4), True)]
    if canon:
        ahead.append((_number(order, data, 12), True))  # the directory of the RAW image
    seen: set[int] = {0}
    left = _MOST_NUMBERS
    while ahead and len(found) < _MAX_DIRECTORIES:
        start, chained = ahead.pop(0)
        if start in seen:
            continue
        seen.add(start)
        directory, end, after = _directory(order, data, start, left)
        left -= sum(map(len, directory.values()))
        found.append(directory)
        needs = max(needs, end)
        for tag in (_EXIF, _SUB):
            below = read_numbers(directory, tag)[:_MAX_DIRECTORIES]
            ahead.extend((start, False) for start in below)
        if chained:
            ahead.append((after, True))
    return TiffTags(tuple(found), needs, canon, order)


def read_numbers(directory: TiffDirectory, tag: int) -> tuple[int, ...]:
    """The whole numbers under a tag of a directory, two for a fraction; empty when there are none.

    For readers of forms of RAW files, which look at one directory at a time.
    """
    found = directory.get(tag)
    return cast("tuple[int, ...]", found) if isinstance(found, tuple) else ()


def read_reals(directory: TiffDirectory, tag: int) -> tuple[float, ...]:
    """The same for a tag whose numbers may be fractions: a black or white level, a stop."""
    return read_numbers(directory, tag)


def _directory(order: str, data: bytes, start: int, most: int) -> tuple[TiffDirectory, int, int]:
    """One directory: its tags, with at most `most` numbers in all; the end of the data that it
    refers to; and where the next directory is (or 0)."""
    directory: TiffDirectory = {}
    if start + 2 > len(data):
        return directory, len(data) + 1, 0
    (entries,) = struct.unpack_from(order + "H", data, start)
    end = start + 2 + 12 * entries + 4
    if end > len(data):
        return directory, end, 0
    if entries > _MOST_ENTRIES:
        return directory, len(data) + 1, 0
    for entry in range(start + 2, end - 4, 12):
        tag, kind, count = struct.unpack_from(order + "HHI", data, entry)
        size = count * _BYTES.get(kind, 0)
        at = entry + 8 if size <= 4 else _number(order, data, entry + 8)
        end = max(end, at + size)
        if tag not in _KEPT or at + size > len(data):
            continue
        if tag == OPCODES:  # of any length: little of it is kept
            if kind == _UNDEFINED:
                directory[tag] = _list_opcodes(data[at : at + size])
            continue
        if (most := most - count) < 0:
            return directory, len(data) + 1, 0
        if kind == _ASCII:
            directory[tag] = data[at : at + size].split(b"\0")[0].decode("ascii", "replace").strip()
        elif kind in (_REALS if tag in _LEVELS else _NUMBERS):
            each = _REALS[kind]
            numbers = struct.unpack_from(f"{order}{count * len(each)}{each[0]}", data, at)
            if tag in _LEVELS:
                numbers = _as_reals(numbers, len(each))
            directory[tag] = numbers
    for offsets, lengths in _DATA:
        for place, size in zip(
            read_numbers(directory, offsets), read_numbers(directory, lengths), strict=False
        ):
            if place != _NOWHERE and not (offsets == STRIP_OFFSETS and data[:4] == _RW2):
                end = max(end, place + size)
    return directory, end, _number(order, data, start + 2 + 12 * entries)


def _list_opcodes(said: bytes) -> tuple[int, ...]:
    """Numbers of the opcodes in a list; the list is big-endian in any file."""
    found: list[int] = []
    at = 4
    for _ in range(min(_number(">", said, 0), _MOST_OPCODES)):
        if at + 16 > len(said):
            break
        found.append(_number(">", said, at))
        at += 16 + _number(">", said, at + 12)
    return tuple(found)


def _as_reals(numbers: tuple[float, ...], parts: int) -> tuple[float, ...]:
    """Numbers, or fractions of two numbers each, as real numbers."""
    if parts == 1:
        return tuple(float(number) for number in numbers)
    pairs = zip(numbers[::2], numbers[1::2], strict=True)
    return tuple(over / under if under else math.nan for over, under in pairs)


def _number(order: str, data: bytes, at: int) -> int:
    """The 32-bit number at that place; 0 beyond the end."""
    return int(struct.unpack_from(order + "I", data, at)[0]) if at + 4 <= len(data) else 0
