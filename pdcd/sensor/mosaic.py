"""The mosaic of a RAW file with its levels: LibRaw's reading and our own, side by side.

For a DNG, black, white, mosaic and picture are read from the file's own tags. LibRaw's values are
compared with them, and a difference is reported. The first photo of each form is decoded twice,
into memory that is filled differently; later ones are, too, if a sample equals the filling.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import rawpy
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.errors import DecodeError
from pdcd.sensor import tiff
from pdcd.sensor.black import (
    Area,
    PlaneBlack,
    choose_dark_areas,
    find_lit_border,
    measure_dark_areas,
)
from pdcd.sensor.dng_form import (
    BAYER,
    PLAIN,
    DngForm,
    describe_mosaic,
    make_packed,
    make_unreadable,
    read_dng_form,
)
from pdcd.sensor.pieces import check_pieces, is_in_order, is_read_here, read_samples
from pdcd.sensor.proof import decode_proven
from pdcd.sensor.tiff import TiffTags, read_tags
from pdcd.sensor.whole import RawData, check_whole, find_stop_tags

_BIG_TIFF = (b"II+\0", b"MM\0+")
_LIBRAW_MIN_SIDE = 22
_CANON_GUARD = 2
"""Unused columns at either edge of a Canon's left border: dcraw leaves them out, too."""
_MORE_BYTES = 1 << 16
"""Bytes appended to a file whose headers do not give its length: none may end up in samples."""
_WHOLE_DN = 1.0
"""Smallest difference of levels that is reported: LibRaw cuts black to whole numbers."""

_proven: dict[tuple[object, ...], bool] = {}
"""Forms with a photo that was decoded twice, and whether LibRaw's samples equal the file's."""


@dataclass(frozen=True)
class RawInput:
    """A RAW file before its samples are unpacked; made by `open_raw`.

    form : of a DNG, else None. found : where the packed samples lie.
    """

    data: bytes
    name: str
    tags: TiffTags | None
    form: DngForm | None
    found: RawData
    libraw: rawpy.RawPy


@dataclass(frozen=True)
class Mosaic:
    """All samples of a sensor, and which part of them is the picture.

    sensor : (H, W) DN, black included; it may lie in LibRaw's memory, which `RawInput` frees.
    first : row and column of the picture's first sample. size : its rows and columns of samples.
    colours : of the quad there; "" for a sensor without colours, which has one plane. white : DN.
    black, libraw_black : (P,) DN of each plane: of R, G1, G2, B, or of grey.
    uneven : black of each plane, where it differs within a plane; `black` is then its mean.
    masked, tagged : whether black is that of a masked border; whether it is that of the file's
        tags.
    doubts : what the user should know, in words.
    """

    sensor: NDArray[np.generic]
    first: tuple[int, int]
    size: tuple[int, int]
    colours: str
    white: float
    black: Floats
    libraw_black: Floats
    uneven: tuple[PlaneBlack, ...] | None
    masked: bool
    tagged: bool
    doubts: tuple[str, ...]

    @property
    def places(self) -> list[tuple[int, int]]:
        """Row and column within the quad of R, G1, G2 and B; one place for a grey plane."""
        return _list_places(self.colours)

    @property
    def step(self) -> int:
        """Distance between neighbours in a plane, in samples of the sensor."""
        return find_quad_side(self.colours)


@contextmanager
def open_raw(data: bytes, name: str) -> Iterator[RawInput]:
    """Open a RAW file called `name`; find its form, and check that all of the file is there.

    For `read_raw` and `read_raw_head`. Raises DecodeError, also in place of LibRaw's own errors.
    """
    if data.startswith(_BIG_TIFF):
        raise make_packed(name, "places of 64 bits (BigTIFF)")
    tags = read_tags(data)
    found = check_whole(data, tags, name)
    form = None if tags is None else read_dng_form(tags, name)
    if form is not None:
        form = replace(form, doubts=form.doubts + check_pieces(data, form, name))
        parts = tuple((piece.offset, piece.size) for piece in form.pieces)
        found = replace(found, parts=parts, packed=form.packing not in PLAIN)
    try:
        with rawpy.imread(io.BytesIO(data)) as libraw:
            yield RawInput(data, name, tags, form, found, libraw)
    except (rawpy.LibRawError, RuntimeError, MemoryError) as err:
        reason = err.args[0].decode() if err.args and isinstance(err.args[0], bytes) else str(err)
        hint = "the file is truncated, damaged or no RAW file; fetch it from the camera again"
        unknown = isinstance(err, rawpy.LibRawFileUnsupportedError)
        if unknown and tags is not None and form is None:
            hint = "the file is whole, its camera or form unknown to LibRaw; convert it to a DNG"
        raise DecodeError(
            f"cannot decode {name}: {reason or type(err).__name__}", hint=hint
        ) from err


def find_quad_side(colours: str) -> int:
    """Samples along a side of one pixel: 2 for a quad of colours, 1 for a sensor without
    colours."""
    return 2 if colours else 1


def is_grey(raw: RawInput) -> bool:
    """Whether an open file comes from a sensor without colours."""
    return raw.libraw.num_colors == 1 if raw.form is None else not raw.form.colours


def read_mosaic(raw: RawInput) -> Mosaic:
    """The samples of an open file, its picture and its levels. Raises DecodeError."""
    sensor, doubts = _read_sensor(raw)
    mosaic = _of_libraw(raw, sensor) if raw.form is None else _of_dng(raw, raw.form, sensor)
    return _with_border(raw, replace(mosaic, doubts=(*doubts, *mosaic.doubts)))


def find_picture(raw: RawInput) -> tuple[tuple[int, int], tuple[int, int]]:
    """Row and column of the picture's first sample, and its rows and columns of samples; a DNG
    gives them as its ActiveArea."""
    sizes = raw.libraw.sizes
    if raw.form is None:
        return (sizes.top_margin, sizes.left_margin), _shown(sizes, (sizes.height, sizes.width))
    top, left, bottom, right = raw.form.active
    return (top, left), _shown(sizes, (bottom - top, right - left))


def read_exposure(raw: RawInput) -> tuple[int, float, float | None]:
    """ISO, exposure time and stop. LibRaw knows where each maker keeps them, but it does not notice
    an undefined fraction, and reads nothing from a file that it does not unpack. Raises
    rawpy.LibRawError."""
    tags = find_stop_tags(raw.data, raw.tags)
    try:
        other = raw.libraw.other
        iso, exposure_s, f_number = round(other.iso_speed), other.shutter_speed, other.aperture
    except rawpy.LibRawError:
        if tags is None or raw.form is None or not is_read_here(raw.form):
            raise
        return read_tagged_exposure(tags)
    if tags is not None and tags.numbers(tiff.EXPOSURE_TIME) and not tags.exposure_s:
        exposure_s = 0.0
    return iso, exposure_s, tags.f_number if tags and tags.says_f_number else f_number


def read_tagged_exposure(tags: TiffTags) -> tuple[int, float, float | None]:
    """The same from the tags of a TIFF alone; 0 and None where they say nothing."""
    return (*tags.numbers(tiff.ISO), 0)[0], tags.exposure_s, tags.f_number


def _shown(sizes: rawpy.ImageSizes, visible: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of the picture, given those that are visible."""
    if 0 < min(sizes.crop_width, sizes.crop_height) < _LIBRAW_MIN_SIDE:
        # LibRaw refuses such a small image, so the mock camera sends a larger one, with a crop for
        # the corner that counts. Crops of real cameras only trim the edge and are not applied.
        return min(visible[0], sizes.crop_height), min(visible[1], sizes.crop_width)
    return visible[0], visible[1]


def _read_sensor(raw: RawInput) -> tuple[NDArray[np.generic], tuple[str, ...]]:
    """All samples, and what is odd about them."""
    form, data = raw.form, raw.data
    sizes = raw.libraw.sizes
    own = form is not None and is_read_here(form)
    if form is not None and _is_own_alone(form):
        return read_samples(data, form, raw.name), ()
    model = raw.tags.text(tiff.MODEL) if raw.tags else ""
    shape = sizes.raw_height, sizes.raw_width
    packing = (form.packing, form.bits, form.pieces[0].needed, form.table) if form else ()
    key = data[:4], model, packing, shape
    sensor = decode_proven(
        lambda: _unpack(raw),
        lambda: _unpack_again(raw, shape),
        _find_used(raw),
        raw.name,
        twice=key not in _proven or not raw.found.sure,
    )
    if key not in _proven:
        own_too = read_samples(data, form, raw.name) if form is not None and own else sensor
        _proven[key] = bool(np.array_equal(own_too, sensor))
    if form is None or _proven[key]:
        if form is not None and sensor.shape != form.shape:
            what = " x ".join(map(str, sensor.shape[::-1]))
            raise DecodeError(
                f"cannot decode {raw.name}: LibRaw finds an image of {what} samples, its tags "
                f"{form.shape[1]} x {form.shape[0]}",
                hint="take the RAW file of the camera",
            )
        return sensor, ()
    said = "LibRaw's samples differ from those in the file; the file's own are used"
    return read_samples(data, form, raw.name), (said,)


def _is_own_alone(form: DngForm) -> bool:
    """Whether only our own reading is right: LibRaw scales real numbers, and reads strips or tiles
    as if they lay in order."""
    return form.floating or not is_in_order(form)


def _find_used(raw: RawInput) -> tuple[slice, slice]:
    """Rows and columns of samples that the picture and black are taken from."""
    if raw.form is not None:
        return slice(None), slice(None)
    sizes, canon = raw.libraw.sizes, raw.tags is not None and raw.tags.canon
    top, left = sizes.top_margin, sizes.left_margin
    columns = slice(0 if canon else left, left + sizes.width)
    return slice(top, top + sizes.height), columns


def _unpack(raw: RawInput) -> NDArray[np.uint16]:
    """LibRaw's samples; pictures whose colours are already made are refused."""
    if raw.libraw.raw_type is not rawpy.RawType.Flat:
        raise make_unreadable(
            raw.name, "a reduced-size or ready-made picture", "set the camera to full-size RAW"
        )
    return raw.libraw.raw_image


def _unpack_again(raw: RawInput, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """The same, decoded again; with more bytes after the file where its length is not known."""
    if not raw.found.sure:
        try:
            longer = raw.data + b"\xa5" * _MORE_BYTES
            with rawpy.imread(io.BytesIO(longer)) as again:
                sensor: NDArray[np.uint16] = again.raw_image.copy()
            if sensor.shape == shape:
                return sensor
        except rawpy.LibRawError:
            pass  # it does not accept the bytes after the file
    with rawpy.imread(io.BytesIO(raw.data)) as again:
        return np.array(again.raw_image)


def _of_libraw(raw: RawInput, sensor: NDArray[np.generic]) -> Mosaic:
    """Levels and picture by LibRaw. Raises DecodeError for any mosaic other than Bayer."""
    libraw = raw.libraw
    corner = libraw.sizes.top_margin, libraw.sizes.left_margin
    numbers, colours = _libraw_mosaic(raw, corner)
    if colours not in ("", *BAYER) or not numbers.size:
        raise make_unreadable(raw.name, *describe_mosaic(colours, numbers.shape[1]))
    black = _libraw_levels(libraw, numbers, _list_places(colours))
    first, size = find_picture(raw)
    return Mosaic(
        sensor=sensor,
        first=first,
        size=(min(size[0], sensor.shape[0] - first[0]), min(size[1], sensor.shape[1] - first[1])),
        colours=colours,
        white=float(libraw.white_level),
        black=black,
        libraw_black=black,
        uneven=None,
        masked=False,
        tagged=False,
        doubts=(),
    )


def _of_dng(raw: RawInput, form: DngForm, sensor: NDArray[np.generic]) -> Mosaic:
    """Levels and picture by the tags of a DNG."""
    first, size = find_picture(raw)
    colours = form.colours
    step = find_quad_side(colours)
    quads = size[0] // step, size[1] // step
    if min(quads) < 1:
        raise DecodeError(
            f"cannot decode {raw.name}: its picture has {size[1]} x {size[0]} samples",
            hint="fetch it from the camera again",
        )
    planes = tuple(form.black.of_plane(place, quads, step) for place in _list_places(colours))
    black = np.array([plane.mean for plane in planes])
    even = all(plane.even for plane in planes)
    libraw_black, doubts = black, list(form.doubts)
    if not _is_own_alone(form):
        numbers, theirs = _libraw_mosaic(raw, first)
        if not numbers.size or theirs != colours:
            none = "of no colours"
            doubts.append(f"LibRaw sees a mosaic {theirs or none}, the tags {colours or none}")
        else:
            libraw_black = _libraw_levels(raw.libraw, numbers, _list_places(colours))
            doubts += _compare_levels(raw, form, black, libraw_black)
    if even and np.array_equal(black, libraw_black):
        black = libraw_black
    if black.max() >= form.white:
        raise DecodeError(
            f"cannot decode {raw.name}: it states black at {black.max():g} DN and white at "
            f"{form.white:g} DN",
            hint="fetch it from the camera again",
        )
    return Mosaic(
        sensor=sensor,
        first=first,
        size=size,
        colours=colours,
        white=form.white,
        black=black,
        libraw_black=libraw_black,
        uneven=None if even else planes,
        masked=False,
        tagged=black is not libraw_black,
        doubts=tuple(doubts),
    )


def _compare_levels(
    raw: RawInput, form: DngForm, black: Floats, libraw_black: Floats
) -> Iterator[str]:
    """Where LibRaw's levels differ from the tags', in forms that LibRaw reads in full."""
    simple = max(form.black.pattern.shape) <= 2 and not (
        form.black.rows.size or form.black.columns.size or form.masked
    )
    begins = form.active[0] % 2 == form.active[1] % 2 == 0
    away = float(np.abs(black - libraw_black).max())
    if simple and begins and away >= _WHOLE_DN:
        yield f"black is {away:.4g} DN away from LibRaw's; the file's tags are believed"
    theirs = float(raw.libraw.white_level)
    if not form.table and abs(theirs - form.white) >= _WHOLE_DN:
        yield f"white is {form.white:g} DN by the tags, {theirs:g} by LibRaw; the tags are believed"


def _with_border(raw: RawInput, mosaic: Mosaic) -> Mosaic:
    """The mosaic with black from a masked border, where there is one that is dark.

    A DNG says where its masked borders are. For a CR2 it is the left border, as in dcraw. The
    borders of other makers' files may hold anything.
    """
    (top, left), doubts = mosaic.first, list(mosaic.doubts)
    areas: list[Area] = []
    tagged = mosaic.black
    if raw.form is not None and raw.form.masked:
        shape = mosaic.sensor.shape
        areas, wrong = choose_dark_areas(raw.form.masked, (shape[0], shape[1]), raw.form.active)
        doubts += [wrong] if wrong else []
        if not raw.form.black.pattern.any():
            tagged = np.full(len(mosaic.places), np.nan)  # zero mostly means that none is given
    elif raw.tags is not None and raw.tags.canon and left > 2 * _CANON_GUARD:
        areas = [(top, _CANON_GUARD, top + raw.libraw.sizes.height, left - _CANON_GUARD)]
    places = [(top + row, left + column) for row, column in mosaic.places]
    measured = measure_dark_areas(mosaic.sensor, areas, places, mosaic.step)
    if not areas:
        return replace(mosaic, doubts=tuple(doubts))
    masked = measured is not None
    if measured is None:  # too few samples: LibRaw uses those there are, or the tags
        measured = mosaic.libraw_black, np.zeros(len(places))
    bottom, right = top + mosaic.size[0], left + mosaic.size[1]
    darkest = np.array(
        [
            np.median(mosaic.sensor[row:bottom:8, column:right:8].astype(np.float64))
            for row, column in places
        ]
    )
    lit, doubt = find_lit_border(measured, tagged, mosaic.white, darkest)
    doubts += [doubt] if doubt else []
    if lit:
        return replace(mosaic, doubts=tuple(doubts))
    return replace(mosaic, black=measured[0], masked=masked, tagged=False, doubts=tuple(doubts))


def _libraw_mosaic(raw: RawInput, first: tuple[int, int]) -> tuple[NDArray[np.uint8], str]:
    """LibRaw's numbers of colours from the picture's `first` sample on, and their letters: G2 is G,
    and a single colour has no letter. Both are empty for a mosaic that LibRaw does not report."""
    libraw = raw.libraw
    if libraw.num_colors == 1:
        return np.zeros((1, 1), np.uint8), ""
    try:
        numbers = libraw.raw_pattern
    except NotImplementedError:  # a mosaic that the binding cannot represent
        numbers = None
    if numbers is None:
        return np.zeros((0, 0), np.uint8), ""
    numbers = np.roll(numbers, (-first[0], -first[1]), axis=(0, 1))
    letters = libraw.color_desc.decode()
    return numbers, "".join(letters[n] if n < len(letters) else "?" for n in numbers.ravel())


def _libraw_levels(
    libraw: rawpy.RawPy, numbers: NDArray[np.uint8], places: list[tuple[int, int]]
) -> Floats:
    levels = libraw.black_level_per_channel
    return np.array([levels[numbers[place]] for place in places], np.float64)


def _list_places(colours: str) -> list[tuple[int, int]]:
    """(row, column) within the quad of R, G1, G2, B, where G1 shares its row with R."""
    if not colours:
        return [(0, 0)]
    red, blue = divmod(colours.index("R"), 2), divmod(colours.index("B"), 2)
    return [red, (red[0], blue[1]), (blue[0], red[1]), blue]
