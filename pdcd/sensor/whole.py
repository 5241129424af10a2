"""Is all of a RAW file there? By what its own headers say, whatever it is built on.

A decoder leaves samples that it does not find as they are in memory. And a file that is still being
written may already have its full length: Windows, network shares and download tools set the length
first, and fill the file later. Sources: TIFF 6.0; ISO 14496-12 (boxes of CR3);
the public descriptions of RAF and RW2.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pdcd.errors import DecodeError
from pdcd.sensor import tiff
from pdcd.sensor.dng_form import JPEG, PLAIN
from pdcd.sensor.pieces import check_lossless_jpeg
from pdcd.sensor.tiff import TiffDirectory, TiffTags, read_numbers, read_tags

_BLOCK_BYTES = 1024
"""Holes are looked for in steps of this."""
_HOLE_BYTES = 128 * _BLOCK_BYTES
"""More zeros in a row than any padding has; in small files a 64th of the data, at least 4 KiB."""
_GAP_BYTES, _END_BYTES = 2**16, 2**12
"""This many zeros amid samples, or at their end, show that samples are still missing: real samples
have noise, and packed ones end with a mark."""
_RW2_BLOCKS = {4: (14, 14), 5: (10, 9), 6: (14, 11), 7: (10, 9)}
"""Samples in 16 bytes, of 12 bits and of more, by the number of RW2's packing. Packing 5 pads the
last bytes of a row, the others leave them out."""
_READY_MADE = 2, 6
"""Kinds of pixels that already have all colours."""
_EXIF_REACH = 1 << 20
_MOST_BOXES = 1000
"""Most boxes of a CR3 that are read; real ones have a dozen."""


@dataclass(frozen=True)
class RawData:
    """Where the packed samples of a file lie.

    parts : offset and bytes of each. packed : whether they are compressed. sure : whether the
    headers give the bytes that are needed, so that any missing one is noticed. jpegs : the parts
    that must be lossless JPEG.
    """

    parts: tuple[tuple[int, int], ...]
    packed: bool
    sure: bool
    jpegs: tuple[tuple[int, int], ...] = ()


def check_whole(data: bytes, tags: TiffTags | None, name: str) -> RawData:
    """Find the packed samples of a file called `name`. Raises DecodeError where it is too short.

    tags : what `read_tags` returned. For `pdcd.sensor.mosaic`, before it looks at anything else.
    """
    found, needs = _find_parts(data, tags)
    hint = "fetch it from the camera again"
    if needs > len(data):
        why = f"it is not whole, {len(data)} bytes of {needs}"
        raise DecodeError(f"cannot decode {name}: {why}", hint=hint)
    if why := _find_overlap(data, tags):
        raise DecodeError(f"cannot decode {name}: {why}", hint=hint)
    for offset, size in found.jpegs:
        check_lossless_jpeg(data[offset : offset + size], 1, "its image", name)
    return found


def find_gap(data: bytes) -> str:
    """What is still missing from a file, in words; "" where it may be complete.

    For drivers that find files which something else writes. A file of unknown form is searched as a
    whole.
    """
    if not data:
        return "it is empty"
    tags = read_tags(data)
    found, needs = _find_parts(data, tags)
    if needs > len(data):
        return f"it has {len(data)} bytes and speaks of {needs}"
    if why := _find_overlap(data, tags):
        return why
    parts = list(found.parts) or [(0, len(data))]
    tiff_parts = tags is not None and found.sure
    if tags is not None and tiff_parts:
        parts = sorted({*_list_filled_parts(tags)}) or parts
    for offset, size in parts:
        if why := _find_zeros(data[offset : offset + size], _END_BYTES if tiff_parts else 0):
            return why
    return ""


def _find_overlap(data: bytes, tags: TiffTags | None) -> str:
    """Whether strips or tiles overlap, in words: a small file could then claim endless samples, all
    of which would be read. A preview may be listed twice."""
    images = {tuple(_list_parts(directory)) for directory in tags.directories} if tags else ()
    if sum(size for image in images for _, size in image) > 2 * len(data):
        return "its strips or tiles lie over each other"
    return ""


def _find_zeros(part: bytes, end_bytes: int) -> str:
    """Where samples are still zeros, in words."""
    if end_bytes and part and not np.frombuffer(part[-end_bytes:], np.uint8).any():
        return "its samples end with zeros, as of a file that is still being filled"
    blocks = len(part) // _GAP_BYTES
    filled = np.frombuffer(part[: blocks * _GAP_BYTES], np.uint8).reshape(blocks, _GAP_BYTES)
    if filled.any(axis=1).all():
        return ""
    return "there are only zeros amid its samples, as of a file that is still being filled"


def _find_parts(data: bytes, tags: TiffTags | None) -> tuple[RawData, int]:
    """Where packed samples lie, and how many bytes the headers refer to."""
    if tags is None:
        return _find_other(data)
    found, needs = _find_rw2(data, tags) if data[:4] == b"IIU\0" else (_find_tiff(tags), 0)
    return found, max(needs, tags.needs_bytes)


def find_stop_tags(data: bytes, tags: TiffTags | None) -> TiffTags | None:
    """The tags that give the stop; in RAF and CR3 those of the EXIF data inside."""
    if tags is not None:
        return tags
    for mark in (b"CMT2", b"Exif\0\0"):
        if (at := data.find(mark, 0, _EXIF_REACH)) >= 0:
            return read_tags(data[at + len(mark) : at + len(mark) + 65536])
    return None


def measure_hole(data: bytes, found: RawData) -> int:
    """Bytes of the longest run of zeros in compressed samples, unless it is padding; else 0.

    Only samples that are all white, or all black, are packed into so many zeros.
    """
    if not found.packed:
        return 0
    size = sum(size for _, size in found.parts)
    least = min(_HOLE_BYTES, max(size // 64, 4 * _BLOCK_BYTES))
    longest = run = 0
    for offset, length in found.parts:
        blocks = min(length, len(data) - offset) // _BLOCK_BYTES
        run = 0
        if blocks < 1:
            continue
        bytes_ = np.frombuffer(data, np.uint8, blocks * _BLOCK_BYTES, offset)
        bytes_ = bytes_.reshape(blocks, _BLOCK_BYTES)
        empty = np.asarray(~bytes_[:, :: _BLOCK_BYTES // 4].any(axis=1))
        for block in np.flatnonzero(empty):
            empty[block] = not bytes_[block].any()
        edges = np.flatnonzero(np.diff(empty, prepend=False, append=False))
        run = int((edges[1::2] - edges[::2]).max(initial=0)) * _BLOCK_BYTES
        longest = max(longest, run)
    return longest if longest >= least else 0


def _find_tiff(tags: TiffTags) -> RawData:
    """Samples of the image that takes most of the file; a CR2's image is lossless JPEG."""
    best: list[tuple[int, int]] = []
    jpegs: list[tuple[int, int]] = []
    packed = True
    for directory in tags.directories:
        parts = _list_parts(directory)
        packing = read_numbers(directory, tiff.COMPRESSION)[:1]
        if sum(size for _, size in parts) > sum(size for _, size in best):
            best, packed = parts, packing != PLAIN
        if tiff.CANON_SLICES in directory and packing in ((6,), JPEG):
            jpegs += parts
    return RawData(tuple(best), packed, sure=True, jpegs=tuple(jpegs))


def _list_parts(directory: TiffDirectory) -> list[tuple[int, int]]:
    """Places and lengths of the strips or tiles of a directory."""
    return [
        part
        for places, lengths in (
            (tiff.STRIP_OFFSETS, tiff.STRIP_BYTES),
            (tiff.TILE_OFFSETS, tiff.TILE_BYTES),
        )
        for part in zip(read_numbers(directory, places), read_numbers(directory, lengths),
                        strict=False)
    ]  # fmt: skip


def _list_all_parts(tags: TiffTags) -> list[tuple[int, int]]:
    return [part for directory in tags.directories for part in _list_parts(directory)]


def _list_filled_parts(tags: TiffTags) -> Iterator[tuple[int, int]]:
    """Parts that never hold only zeros, as an uncompressed preview of a dark photo may do."""
    for directory in tags.directories:
        packing, kind = (
            (*read_numbers(directory, tag), 1)[0] for tag in (tiff.COMPRESSION, tiff.PHOTOMETRIC)
        )
        if packing not in PLAIN or kind not in _READY_MADE:
            yield from _list_parts(directory)


def _find_rw2(data: bytes, tags: TiffTags) -> tuple[RawData, int]:
    """Samples of an RW2, and bytes it needs: each sample takes the same number of bits, except in
    files of the newest cameras."""

    def one(tag: int, otherwise: int = 0) -> int:
        return (*tags.numbers(tag), otherwise)[0]

    offset = one(tiff.RW2_DATA)
    if not offset:
        return RawData(tuple(_list_all_parts(tags)), packed=True, sure=False), 0
    way, width = one(tiff.RW2_FORMAT, 4), one(tiff.RW2_WIDTH)
    many = _RW2_BLOCKS.get(way, (width + 1,) * 2)[0 if one(tiff.RW2_BITS, 12) <= 12 else 1]
    needs = one(tiff.RW2_HEIGHT) * ((width + many - 1 if way == 5 else width) // many) * 16
    size = max(len(data) - offset, 0)
    return RawData(((offset, size),), packed=True, sure=False), offset + needs


def _find_other(data: bytes) -> tuple[RawData, int]:
    """Samples of RAF and CR3; nothing is known of any other file."""
    if data.startswith(b"FUJIFILMCCD-RAW"):
        pairs = [struct.unpack_from(">2I", data.ljust(108, b"\0"), at) for at in (84, 92, 100)]
        needs = max(108, *(offset + size for offset, size in pairs))
        return RawData((pairs[2],), packed=True, sure=True), needs
    if data[4:12] == b"ftypcrx ":
        boxes = list(_list_boxes(data))
        parts = tuple((at, size) for kind, at, size in boxes if kind == b"mdat")
        needs = max((at + size for _, at, size in boxes), default=0)
        if not parts:
            needs = max(needs, len(data) + 1)
        return RawData(parts, packed=True, sure=True), needs
    return RawData((), packed=False, sure=False), 0


def _list_boxes(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Kind, place and length of each box, up to the end of the file."""
    at = 0
    for _ in range(_MOST_BOXES):
        if at >= len(data):
            return
        if at + 8 > len(data):
            yield b"", at, 8
            return
        size, kind = struct.unpack_from(">I4s", data, at)
        if size == 1 and at + 16 <= len(data):
            (size,) = struct.unpack_from(">Q", data, at + 8)
        elif size == 0:
            size = len(data) - at
        if size < 8:
            return
        yield kind, at, size
        at += size
    yield b"", len(data), 1
