"""The tags of a file built on TIFF: DNG, CR2, NEF, ARW.

LibRaw's Python binding leaves out the camera's name, the date and the masked borders, and it does
not tell a file that is still being written from one that is damaged. Source: TIFF 6.0, section 2;
Adobe DNG specification 1.4, chapter 4.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

MODEL, _EXIF, _SUB = 272, 34665, 330
DATE_TAKEN, MASKED_AREAS, EXPOSURE_TIME = 36867, 50830, 33434
_DATA = ((273, 279), (324, 325), (513, 514))  # offsets and lengths of strips, tiles, a preview
_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
_NUMBERS = {1: "B", 3: "H", 4: "I", 5: "II", 13: "I"}
_ASCII = 2
_MAX_DIRECTORIES = 64
"""Real files have fewer than ten; a damaged one may chain them without end."""
_KEPT = {MODEL, _EXIF, _SUB, DATE_TAKEN, MASKED_AREAS, EXPOSURE_TIME}.union(*_DATA)


@dataclass(frozen=True)
class TiffTags:
    """Tags of all directories of a file.

    directories : numbers or text of each tag this module knows, one dictionary a directory.
    needs_bytes : where the data that the directories speak of end. A file that is shorter is not
        whole; one that a directory of lies behind the end needs one byte more than it has.
    canon : whether it is a CR2.
    """

    directories: tuple[dict[int, tuple[int, ...] | str], ...]
    needs_bytes: int
    canon: bool

    def text(self, tag: int) -> str:
        """The first text under a tag, "" when there is none."""
        return next((v for d in self.directories if isinstance(v := d.get(tag), str)), "")

    def numbers(self, tag: int) -> tuple[int, ...]:
        """The first numbers under a tag, empty when there are none."""
        return next((v for d in self.directories if isinstance(v := d.get(tag), tuple)), ())

    @property
    def exposure_s(self) -> float:
        """How long the camera says that it exposed; 0 where it says nothing."""
        said = self.numbers(EXPOSURE_TIME)
        return said[0] / said[1] if len(said) == 2 and said[1] else 0.0


def read_tags(data: bytes) -> TiffTags | None:
    """The tags of a file's bytes; None for one that does not begin like TIFF. Never raises."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    if order is None:
        return None
    canon = data[8:10] == b"CR"
    found: list[dict[int, tuple[int, ...] | str]] = []
    needs = 8
    ahead = [_number(order, data, 4)]
    if canon:
        ahead.append(_number(order, data, 12))  # the directory of the RAW image
    seen: set[int] = {0}
    while ahead and len(found) < _MAX_DIRECTORIES:
        start = ahead.pop(0)
        if start in seen:
            continue
        seen.add(start)
        directory, end, after = _directory(order, data, start)
        found.append(directory)
        needs = max(needs, end)
        for tag in (_EXIF, _SUB):
            ahead.extend(v for v in directory.get(tag, ()) if isinstance(v, int))
        ahead.append(after)
    return TiffTags(tuple(found), needs, canon)


def _directory(
    order: str, data: bytes, start: int
) -> tuple[dict[int, tuple[int, ...] | str], int, int]:
    """One directory: its tags, the end of what it speaks of, and where the next one is (or 0)."""
    directory: dict[int, tuple[int, ...] | str] = {}
    if start + 2 > len(data):
        return directory, len(data) + 1, 0
    (entries,) = struct.unpack_from(order + "H", data, start)
    end = start + 2 + 12 * entries + 4
    if end > len(data):
        return directory, end, 0
    for entry in range(start + 2, end - 4, 12):
        tag, kind, count = struct.unpack_from(order + "HHI", data, entry)
        size = count * _BYTES.get(kind, 0)
        at = entry + 8 if size <= 4 else _number(order, data, entry + 8)
        end = max(end, at + size)
        if tag not in _KEPT or at + size > len(data):
            continue
        if kind == _ASCII:
            directory[tag] = data[at : at + size].split(b"\0")[0].decode("ascii", "replace").strip()
        elif kind in _NUMBERS:
            each = _NUMBERS[kind]
            form = f"{order}{count * len(each)}{each[0]}"
            directory[tag] = struct.unpack_from(form, data, at)
    for offsets, lengths in _DATA:
        for place, size in zip(
            directory.get(offsets, ()), directory.get(lengths, ()), strict=False
        ):
            if isinstance(place, int) and isinstance(size, int):
                end = max(end, place + size)
    return directory, end, _number(order, data, start + 2 + 12 * entries)


def _number(order: str, data: bytes, at: int) -> int:
    """The 32-bit number there; 0 behind the end."""
    return int(struct.unpack_from(order + "I", data, at)[0]) if at + 4 <= len(data) else 0
