"""What a DNG says of its samples: where they lie, in which form, their mosaic and their levels.

Forms that hold neither a 2x2 Bayer mosaic nor one grey plane, or that nothing here unpacks, are
refused with an error that names the form.
Source: Adobe DNG specification 1.4 and 1.7, chapters 2, 4 and 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdcd.errors import DecodeError
from pdcd.sensor import tiff
from pdcd.sensor.black import Area, BlackLevels
from pdcd.sensor.tiff import TiffDirectory, TiffTags, read_numbers, read_reals

BAYER = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Mosaics that are read and written: colours of the quad, row by row."""
PLAIN, JPEG, DEFLATE = (1,), (7,), (8, 32946)
"""Compression numbers that can be read."""
_CFA, _LINEAR = 32803, 34892
_COLOURS = "RGBCMYW"
_HEADER_BYTES = 8
_MOST_PIECES = 2**16
"""Most strips or tiles that are read: nobody writes more than a strip for each row."""
_PACKINGS = {9: "VC-5", 34892: "lossy JPEG", 52546: "JPEG XL", 5: "LZW", 32773: "PackBits"}
_MOVES = {1, 2, 6, 14}
"""Numbers of opcodes that warp or trim a picture but do not change its light."""
_OPCODES = {
    3: "FixVignetteRadial", 4: "FixBadPixelsConstant", 5: "FixBadPixelsList", 7: "MapTable",
    8: "MapPolynomial", 9: "GainMap", 10: "DeltaPerRow", 11: "DeltaPerColumn", 12: "ScalePerRow",
    13: "ScalePerColumn",
}  # fmt: skip
_REPACK = "set the camera or the converter to a DNG with lossless JPEG, or an uncompressed one"


@dataclass(frozen=True)
class SamplePiece:
    """A strip or tile: where its bytes lie, and the samples of the sensor that it holds.

    needed : rows and columns of samples in the bytes; a tile at the edge has more than it shows.
    """

    offset: int
    size: int
    row: int
    column: int
    needed: tuple[int, int]


@dataclass(frozen=True)
class DngForm:
    """The form of a DNG's mosaic.

    shape : rows and columns of all samples. bits, floating : of a sample. packing : one of `PLAIN`,
    `JPEG` and `DEFLATE`. predictor, order, pieces : how and where the samples lie.
    table : the value of each stored number; empty where numbers stand for themselves.
    active : the picture. colours : of the quad in its corner; "" for a sensor without colours.
    black, white : levels in DN.
    masked : numbers of masked areas, as in the file. doubts : what is odd, in words.
    """

    shape: tuple[int, int]
    bits: int
    floating: bool
    packing: int
    predictor: int
    order: str
    pieces: tuple[SamplePiece, ...]
    table: tuple[int, ...]
    active: Area
    colours: str
    black: BlackLevels
    white: float
    masked: tuple[int, ...]
    doubts: tuple[str, ...]


def read_dng_form(tags: TiffTags, name: str) -> DngForm | None:
    """The form of the RAW image in a file called `name`; None for a file that is no DNG.

    Raises DecodeError for one that cannot be read, or contradicts itself.
    """
    if not any(tiff.DNG_VERSION in directory for directory in tags.directories):
        return None
    main = _find_mosaic(tags, name)
    shape = _one(main, tiff.IMAGE_LENGTH, 0), _one(main, tiff.IMAGE_WIDTH, 0)
    if min(shape) < 1 or max(shape) > 65535:
        raise _contradiction(name, f"an image of {shape[1]} x {shape[0]} samples")
    colours = _read_mosaic(main, name)
    packing = _one(main, tiff.COMPRESSION, 1)
    if packing not in PLAIN + JPEG + DEFLATE:
        raise make_packed(name, _PACKINGS.get(packing, f"number {packing}"))
    if any({*read_numbers(main, tag)} - {1} for tag in tiff.INTERLEAVES):
        raise make_packed(name, "its rows, columns or blocks in another order")
    pieces = _list_pieces(main, shape, name)
    if packing in JPEG and len(pieces) > 1 and tiff.TILE_WIDTH not in main:
        raise make_packed(name, "lossless JPEG in several strips")
    bits, kind = _one(main, tiff.BITS, 1), _one(main, tiff.SAMPLE_FORMAT, 1)
    floating, predictor = kind == 3, _one(main, tiff.PREDICTOR, 1)
    real = bits in (16, 24, 32) and packing not in JPEG and predictor in (1, 3, 34894, 34895)
    known = real if floating else 8 <= bits <= 16 and packing not in DEFLATE
    if not known or kind not in (1, 3) or _one(main, tiff.FILL_ORDER, 1) != 1:
        form = f"{bits}-bit samples of format {kind}, packed in the way {packing}.{predictor}"
        raise DecodeError(
            f"cannot decode {name}: it has {form}, which nothing here reads", hint=_REPACK
        )
    doubts: list[str] = []
    active = _read_active(main, shape, doubts)
    doubts += _describe_opcodes(main)
    levels = _Levels(tags, main, name)
    white = levels.read_white(1.0 if floating else float(2**bits - 1))
    return DngForm(
        shape=shape,
        bits=bits,
        floating=floating,
        packing=packing,
        predictor=predictor,
        order=tags.order,
        pieces=pieces,
        table=() if floating else read_numbers(main, tiff.LINEARIZATION),
        active=active,
        colours=colours,
        black=levels.read_black(active, doubts),
        white=white,
        masked=read_numbers(main, tiff.MASKED_AREAS) or tags.numbers(tiff.MASKED_AREAS),
        doubts=tuple(doubts),
    )


def make_packed(name: str, what: str) -> DecodeError:
    """The error for a whole file whose samples are packed in a way that is not read; for
    readers."""
    return DecodeError(
        f"cannot decode {name}: it is packed with {what}, which nothing here reads", hint=_REPACK
    )


def make_unreadable(name: str, what: str, hint: str) -> DecodeError:
    """The error for a whole file that holds `what`, which cannot be read; for every reader."""
    return DecodeError(
        f"cannot decode {name}: it is {what}, with no 2x2 Bayer mosaic of red, green and blue, and "
        "no plane of grey",
        hint=hint,
    )


def describe_mosaic(pattern: str, columns: int) -> tuple[str, str]:
    """What a mosaic is called, and what to do about it.

    pattern : colours of all its places, row by row; `columns` is its width.
    """
    rows = len(pattern) // columns if columns else 0
    if (rows, columns) == (6, 6):
        return "of an X-Trans sensor", "take a camera with a Bayer mosaic"
    quads = [pattern[4 * row : 4 * row + 4] for row in range(4)]
    paired = (rows, columns) == (4, 4) and quads[0] == quads[1] and quads[2] == quads[3]
    if paired and all(quad[0] == quad[1] and quad[2] == quad[3] for quad in quads):
        return "of a quad Bayer sensor", "set the camera to its RAW of a quarter of the pixels"
    return (
        f"of a mosaic of {columns} x {rows} places, {pattern[:36] or 'unknown'}",
        "take a camera with a Bayer mosaic",
    )


def _find_mosaic(tags: TiffTags, name: str) -> TiffDirectory:
    """The directory of the full-size mosaic, or grey plane. Raises DecodeError where there is
    none."""
    full = [found for found in tags.directories if not _one(found, tiff.SUBFILE_TYPE, 0)]

    def size(found: TiffDirectory) -> tuple[int, int]:
        return _one(found, tiff.IMAGE_WIDTH, 0), _one(found, tiff.IMAGE_LENGTH, 0)

    of_sensor = [found for found in full if _one(found, tiff.PHOTOMETRIC, -1) in (_CFA, _LINEAR)]
    for kind in (_CFA, _LINEAR):
        there = [found for found in of_sensor if _one(found, tiff.PHOTOMETRIC, -1) == kind]
        if there:
            break
    else:
        raise _contradiction(name, "no image of a sensor")
    main = max(there, key=lambda found: math.prod(size(found)))
    if sum(size(found) == size(main) for found in of_sensor) > 1:  # a decoder takes any of them
        raise make_unreadable(
            name, "of several full-size images", "take the RAW file of the camera"
        )
    if kind != _CFA and _one(main, tiff.SAMPLES_PER_PIXEL, 1) != 1:
        raise make_unreadable(
            name, "a linear DNG, whose colours are made already", "take the RAW file of the camera"
        )
    return main


def _read_mosaic(main: TiffDirectory, name: str) -> str:
    """Colours of the quad in the ActiveArea's corner, "" for a grey plane. Raises DecodeError for
    another mosaic."""
    if _one(main, tiff.PHOTOMETRIC, -1) != _CFA:
        return ""
    rows, columns = (*read_numbers(main, tiff.CFA_DIM), 2, 2)[:2]
    numbers = read_numbers(main, tiff.CFA_PATTERN)
    pattern = "".join(_COLOURS[n] if n < len(_COLOURS) else "?" for n in numbers)
    if _one(main, tiff.SAMPLES_PER_PIXEL, 1) != 1 or _one(main, tiff.CFA_LAYOUT, 1) != 1:
        raise make_unreadable(
            name, "of a mosaic in staggered rows or several parts", "take another camera"
        )
    if (rows, columns) != (2, 2) or pattern not in BAYER:
        raise make_unreadable(name, *describe_mosaic(pattern, columns))
    return pattern


def _read_active(main: TiffDirectory, shape: tuple[int, int], doubts: list[str]) -> Area:
    whole = 0, 0, *shape
    said = read_numbers(main, tiff.ACTIVE_AREA)
    if not said:
        return whole
    if len(said) == 4:
        top, left, bottom, right = said
        if top < bottom <= shape[0] and left < right <= shape[1]:
            return top, left, bottom, right
    doubts.append("the ActiveArea lies beyond the file; all samples are taken for the picture")
    return whole


def _describe_opcodes(main: TiffDirectory) -> list[str]:
    """What the file asks to be done to its stored samples; neither pdcd nor LibRaw does it."""
    asked = dict.fromkeys(n for n in read_numbers(main, tiff.OPCODES) if n not in _MOVES)
    if not asked:
        return []
    names = ", ".join(_OPCODES.get(n, f"opcode {n}") for n in asked)
    return [f"the file asks for {names} (OpcodeList1), which is not done: samples are as stored"]


def _list_pieces(main: TiffDirectory, shape: tuple[int, int], name: str) -> tuple[SamplePiece, ...]:
    """Strips or tiles with the samples they hold. Raises DecodeError where they are too few."""
    (height, width), tiled = shape, tiff.TILE_WIDTH in main
    if tiled:
        rows, columns = _one(main, tiff.TILE_LENGTH, 0), _one(main, tiff.TILE_WIDTH, 0)
        offsets, sizes = (read_numbers(main, t) for t in (tiff.TILE_OFFSETS, tiff.TILE_BYTES))
    else:
        rows, columns = min(_one(main, tiff.ROWS_PER_STRIP, height), height), width
        offsets, sizes = (read_numbers(main, t) for t in (tiff.STRIP_OFFSETS, tiff.STRIP_BYTES))
    count = math.ceil(height / rows) * math.ceil(width / columns) if rows and columns else 0
    if not 0 < count <= _MOST_PIECES or len(offsets) < count or len(sizes) < count:
        said = f"{len(offsets)} places and {len(sizes)} lengths of {count} strips or tiles"
        raise _contradiction(name, said)
    if min(offsets[:count]) < _HEADER_BYTES:  # as of a writer that puts in places at the end
        raise _contradiction(name, "samples at the place of its header")
    pieces = []
    across = math.ceil(width / columns)
    for number in range(count):
        row, column = number // across * rows, number % across * columns
        needed = (rows if tiled else min(rows, height - row)), columns
        pieces.append(SamplePiece(offsets[number], sizes[number], row, column, needed))
    return tuple(pieces)


@dataclass(frozen=True)
class _Levels:
    """Reads black and white of the image; some writers put them into another directory."""

    tags: TiffTags
    main: TiffDirectory
    name: str

    def _home(self, tag: int) -> TiffDirectory:
        places = self.main, *self.tags.directories
        return next((found for found in places if read_reals(found, tag)), self.main)

    def _said(self, tag: int) -> tuple[float, ...]:
        said = read_reals(self._home(tag), tag)
        if not all(map(math.isfinite, said)):
            raise _contradiction(self.name, f"a level that is no number (tag {tag})")
        return said

    def read_white(self, highest: float) -> float:
        """The white level in DN; the highest number of a sample where the file gives none."""
        white = (*self._said(tiff.WHITE_LEVEL), highest)[0]
        if white <= 0.0:
            raise _contradiction(self.name, f"a white level of {white:g}")
        return white

    def read_black(self, active: Area, doubts: list[str]) -> BlackLevels:
        """Black levels in DN. Raises DecodeError where their numbers do not fit the picture."""
        said = self._said(tiff.BLACK_LEVEL) or (0.0,)
        rows, columns = (*read_numbers(self._home(tiff.BLACK_LEVEL), tiff.BLACK_DIM), 1, 1)[:2]
        if len(said) == 1:
            said = said * (rows * columns if 0 < rows * columns < 2**16 else 1)
        if not rows * columns or len(said) < rows * columns:
            raise _contradiction(
                self.name, f"{len(said)} black levels for {columns} x {rows} places"
            )
        if len(said) > rows * columns:
            doubts.append(f"{len(said)} black levels for {rows * columns}; the first are taken")
        pattern = np.array(said[: rows * columns], np.float64).reshape(rows, columns)
        deltas = []
        for tag, length in (
            (tiff.BLACK_DELTA_V, active[2] - active[0]),
            (tiff.BLACK_DELTA_H, active[3] - active[1]),
        ):
            more = np.array(self._said(tag), np.float64)
            if more.size not in (0, length):
                raise _contradiction(
                    self.name, f"{more.size} differences of black for {length} rows or columns"
                )
            deltas.append(more if more.any() else np.empty(0))
        return BlackLevels(pattern, *deltas)


def _one(found: TiffDirectory, tag: int, otherwise: int) -> int:
    numbers = read_numbers(found, tag)
    return numbers[0] if numbers else otherwise


def _contradiction(name: str, what: str) -> DecodeError:
    return DecodeError(
        f"cannot decode {name}: it states {what}", hint="fetch it from the camera again"
    )
