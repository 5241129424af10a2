"""Our own reading of the samples of a DNG that is not compressed, or deflated.

LibRaw scales samples that are real numbers by the largest of each photo, but photos are subtracted
from each other here. And one decoder alone is no proof. So everything that does not need a
decoder of its own is read here, and LibRaw's reading of whole numbers is compared with it. Source:
TIFF 6.0, sections 8, 14 and 15; TIFF technical note 3; Adobe DNG specification 1.4, chapters 2 and
5.
"""

from __future__ import annotations

import math
import zlib
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.sensor.bands import run_in_bands
from pdcd.sensor.dng_form import DEFLATE, JPEG, PLAIN, DngForm, SamplePiece, make_packed

_PLANES = {3: 1, 34894: 2, 34895: 4}
"""Predictors of real numbers, whose bytes lie plane by plane: each byte is the difference from the
one this many bytes before it."""
_FEW_BYTES = 64
"""Bytes of a part that are checked first, to see whether it may be all zeros."""
_JPEG_START, _JPEG_END, _JPEG_SCAN, _LOSSLESS = b"\xff\xd8", b"\xff\xd9", 0xDA, 0xC3
_MOST_SEGMENTS = 1000
"""Most segments before the samples; real files have three."""
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def is_read_here(form: DngForm) -> bool:
    """Whether `read_samples` can read a file of this form, without LibRaw."""
    return form.packing in PLAIN + DEFLATE


def is_in_order(form: DngForm) -> bool:
    """Whether uncompressed strips or tiles lie one after another, as LibRaw assumes. Files where
    they do not are only read here."""
    return form.packing not in PLAIN or all(
        piece.offset + count_plain_bytes(form, piece) == following.offset
        for piece, following in pairwise(form.pieces)
    )


def check_pieces(data: bytes, form: DngForm, name: str) -> tuple[str, ...]:
    """Check every strip and tile against the file, the others and the samples that it must hold.
    Returns what is odd, in words.

    Raises DecodeError where one lies beyond the end or over another one, is too short, is not
    lossless JPEG where it must be, or holds only zeros while another one does not.
    """
    empty, odd = [], ""
    for number, piece in enumerate(form.pieces, 1):
        where = f"part {number} of {len(form.pieces)}"
        if piece.offset + piece.size > len(data):
            end = piece.offset + piece.size
            raise _absent(name, f"{where} ends at byte {end} of {len(data)}")
        if form.packing in PLAIN:
            least, said = count_plain_bytes(form, piece), f"{where} has {piece.size} bytes"
            if piece.size < least:
                raise _absent(name, f"{said}, {least} are needed")
            if piece.size - least >= max(piece.needed[0], _FEW_BYTES):  # one more a row
                odd = odd or f"{said}, its samples take {least}: are rows or samples too wide?"
        if form.packing in JPEG:
            check_lossless_jpeg(
                data[piece.offset : piece.offset + piece.size],
                math.prod(piece.needed),
                where,
                name,
                columns=piece.needed[1],
            )
        elif not any(data[piece.offset : piece.offset + _FEW_BYTES]):
            there = np.frombuffer(data, np.uint8, piece.size, piece.offset)
            empty += [] if there.any() else [where]
    if 0 < len(empty) < len(form.pieces):
        raise _absent(name, f"{empty[0]} holds zeros only")
    places = sorted(
        (piece.offset, count_plain_bytes(form, piece) if form.packing in PLAIN else piece.size)
        for piece in form.pieces
    )
    if any(at + size > following for (at, size), (following, _) in pairwise(places)):
        raise _absent(name, "strips or tiles lie over each other")
    return (odd,) if odd else ()


def count_plain_bytes(form: DngForm, piece: SamplePiece) -> int:
    """Bytes of an uncompressed strip or tile: every row begins at a new byte."""
    rows, columns = piece.needed
    return rows * -(-columns * form.bits // 8)


def check_lossless_jpeg(
    data: bytes, samples: int, where: str, name: str, *, columns: int = 0
) -> None:
    """Check that lossless JPEG data holds at least `samples` samples and has an end.

    columns : width of the place that they fill; 0 for no check. Rows of another width fill it one
    after another, which needs exactly `samples` samples. Where samples are missing, a decoder
    leaves memory as it was. Raises DecodeError.
    """
    at = 2 if data.startswith(_JPEG_START) else len(data)
    held = segments = across = 0
    while at + 9 < len(data) and data[at] == 0xFF and data[at + 1] != _JPEG_SCAN:
        if segments == _MOST_SEGMENTS:
            break
        if data[at + 1] in _FRAMES:
            rows, across = (int.from_bytes(data[i : i + 2], "big") for i in (at + 5, at + 7))
            across *= data[at + 9]
            held = rows * across
            if data[at + 1] != _LOSSLESS:
                raise make_packed(name, "lossy JPEG")
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        segments += 1
    if data[at : at + 2] != bytes((0xFF, _JPEG_SCAN)) or held < samples:
        raise _absent(name, f"{where} is no lossless JPEG of {samples} samples")
    if columns and held != samples and across != columns:
        raise _absent(name, f"{where} has rows of {across} samples, not {columns}")
    if data.rfind(_JPEG_END) < at:
        raise _absent(name, f"the lossless JPEG of {where} has no end")


def read_samples(data: bytes, form: DngForm, name: str) -> NDArray[np.uint16 | np.float32]:
    """All samples of a sensor, (H, W) in DN: uint16, or float32 of real numbers.

    data, form : a file and what it says of itself, both checked by `check_pieces`.
    Raises DecodeError for damaged data and for samples that are not finite numbers.
    """
    height, width = form.shape
    samples = np.empty(form.shape, np.float32 if form.floating else np.uint16)
    for piece in form.pieces:
        found = _unpack(data, form, piece, name)
        rows = min(piece.needed[0], height - piece.row)
        columns = min(piece.needed[1], width - piece.column)
        place = samples[piece.row : piece.row + rows, piece.column : piece.column + columns]
        _copy(found, place)
    if form.table:
        samples = np.take(np.array(form.table, np.uint16), samples, mode="clip")
    if form.floating and not np.isfinite(samples).all():
        raise DecodeError(
            f"cannot decode {name}: some samples are no numbers",
            hint="take the RAW file of the camera",
        )
    return samples


def _copy(found: NDArray[Any], place: NDArray[Any]) -> None:
    """Copy the rows of a piece to their place, as far as they lie in the picture."""
    height, width = place.shape

    def band(rows: slice) -> None:
        place[rows] = found[rows, :width]

    run_in_bands(height, band)


def _unpack(data: bytes, form: DngForm, piece: SamplePiece, name: str) -> NDArray[Any]:
    """Samples of one strip or tile, (rows, columns)."""
    rows, columns = piece.needed
    stride = -(-columns * form.bits // 8)
    if form.packing in PLAIN:
        packed = np.frombuffer(data, np.uint8, rows * stride, piece.offset)
        return _as_numbers(packed.reshape(rows, stride), columns, form)
    inflater = zlib.decompressobj()
    try:
        plain = inflater.decompress(data[piece.offset : piece.offset + piece.size], rows * stride)
        inflater.decompress(inflater.unconsumed_tail, 1)  # the check sum at the end
    except zlib.error as err:
        raise _absent(name, f"deflated samples: {err}") from err
    if len(plain) < rows * stride:
        raise _absent(name, f"{len(plain)} deflated bytes, {rows * stride} are needed")
    if not inflater.eof:
        raise _absent(name, f"the deflated samples do not end after {rows * stride} bytes")
    packed = np.frombuffer(plain, np.uint8).reshape(rows, stride)
    if form.predictor in _PLANES:
        return _join_planes(packed, form.bits // 8, _PLANES[form.predictor])
    return _as_numbers(packed, columns, form)


def _join_planes(packed: NDArray[np.uint8], size: int, step: int) -> NDArray[np.float32]:
    """Real numbers whose bytes were sorted by rank, highest first, and then differenced."""
    summed = packed.copy()
    for first in range(step):
        np.cumsum(packed[:, first::step], axis=1, dtype=np.uint8, out=summed[:, first::step])
    rows = packed.shape[0]
    joined = np.ascontiguousarray(summed.reshape(rows, size, -1).swapaxes(1, 2))
    return _as_floats(joined.reshape(rows, -1), size, ">")


def _as_numbers(packed: NDArray[np.uint8], columns: int, form: DngForm) -> NDArray[Any]:
    """Bytes of rows as samples."""
    if form.floating:
        return _as_floats(packed, form.bits // 8, form.order)
    if form.bits == 8:
        return packed
    if form.bits == 16:
        return packed.view(f"{form.order}u2")
    return _unpack_bits(packed, columns, form.bits)


def _as_floats(packed: NDArray[np.uint8], size: int, order: str) -> NDArray[np.float32]:
    """Bytes of rows as real numbers of 2, 3 or 4 bytes."""
    if size != 3:
        found: NDArray[Any] = packed.view(f"{order}f{size}")
        return np.array(found, np.float32)
    three = packed.reshape(packed.shape[0], -1, 3)
    three = three[..., ::-1] if order == "<" else three
    mantissa = three[..., 1].astype(np.float64) * 256.0 + three[..., 2]
    exponent = (three[..., 0] & 0x7F).astype(np.int32)
    value = np.ldexp(mantissa + (exponent > 0) * 65536.0, np.maximum(exponent, 1) - 63 - 16)
    value[exponent == 0x7F] = np.nan
    with np.errstate(over="ignore"):
        return np.asarray(np.where(three[..., 0] & 0x80, -value, value), np.float32)


def _unpack_bits(packed: NDArray[np.uint8], columns: int, bits: int) -> NDArray[Any]:
    """Whole numbers of `bits` bits, highest bit first, whatever the file's byte order."""
    group = math.lcm(bits, 8)
    many, size = group // bits, group // 8
    groups = -(-columns // many)
    rows = packed.shape[0]
    out = np.empty((rows, groups * many), np.uint16)

    def band(here: slice) -> None:
        some = packed[here]
        padded = np.zeros((some.shape[0], groups * size), np.uint8)
        padded[:, : some.shape[1]] = some
        parts = padded.reshape(some.shape[0], groups, size)
        for number in range(many):
            first, skipped = divmod(number * bits, 8)
            last = (number * bits + bits - 1) // 8
            value: NDArray[Any] = parts[..., first].astype(np.uint32)
            for byte in range(first + 1, last + 1):
                value = value << 8 | parts[..., byte]
            value = value >> (8 * (last - first + 1) - skipped - bits)
            out[here, number::many] = value & ((1 << bits) - 1)

    run_in_bands(rows, band)
    return out


def _absent(name: str, what: str) -> DecodeError:
    return DecodeError(
        f"cannot decode {name}: not all samples are in it: {what}",
        hint="fetch it from the camera again",
    )
