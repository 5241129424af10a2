"""A minimal DNG writer: the RAW file of the virtual camera.

A DNG is a TIFF: a header, one directory (IFD) of tags for the image, one for the EXIF data, and
the samples. Only what RAW decoders need is written: little-endian, one uncompressed strip of 16-bit
samples, an RGGB mosaic, DNG version 1.4. Not modelled: previews, lossless compression, lens and
maker data.

LibRaw 0.22 and dcraw 9.28 refuse images below 22 samples a side, ActiveArea included, so a smaller
mosaic is laid into the corner of a frame of black-level samples and described by DefaultCropSize,
which `pdcd.sensor.raw` follows.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from datetime import datetime
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError

MIN_SIDE = 22
"""Least width and height, in samples, that LibRaw takes for a RAW image."""

# TIFF field types that are used here: number in the file, and how one value is packed.
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _UNDEFINED, _SRATIONAL = 1, 2, 3, 4, 5, 7, 10
_PACKING = {_BYTE: "B", _SHORT: "H", _LONG: "I", _RATIONAL: "II", _SRATIONAL: "ii"}

# CIE XYZ to the camera's primaries under D65: those of linear sRGB (IEC 61966-2-1), in 1e-4.
_XYZ_TO_CAMERA = (32406, -15372, -4986, -9689, 18758, 415, 557, -2040, 10570)
_D65 = 21

_Field = tuple[int, int, bytes]  # type, count, value


def dng_bytes(
    mosaic: NDArray[np.uint16],
    *,
    black: int,
    white: int,
    iso: int,
    exposure_s: float,
    f_number: float | None,
    model: str,
    date: datetime,
    as_shot_neutral: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> bytes:
    """Make an RGGB mosaic into an uncompressed DNG file.

    Parameters
    ----------
    mosaic : (H, W) uint16
        Samples in DN, H and W even, row 0 column 0 red.
    black, white
        Black level and saturation level, in DN, equal for the four colours of the mosaic.
    iso, exposure_s, f_number, model, date
        What the EXIF tags say; `f_number` None (an aperture the camera does not know) is left out.
        Only the wall-clock fields of `date` are kept, to the second.
    as_shot_neutral
        Camera response (R, G, B) to a neutral surface, the inverse of the white balance.

    Returns
    -------
    bytes
        The whole file.

    Raises
    ------
    ConfigError
        The mosaic is not (even, even) uint16.

    Source: TIFF 6.0; Adobe DNG specification 1.4, chapters 2 and 4; EXIF 2.3, section 4.6.
    """
    if mosaic.dtype != np.uint16 or mosaic.ndim != 2 or 0 in mosaic.shape or _odd(mosaic.shape):
        raise ConfigError(
            f"a DNG needs an (even, even) uint16 mosaic, not {mosaic.shape} {mosaic.dtype}",
            hint="give whole Bayer quads",
        )
    frame = _framed(mosaic, black)
    exif = _exif(iso, exposure_s, f_number, date)
    image = _image(frame, mosaic.shape, black, white, model, date, as_shot_neutral)
    header_bytes = 8
    exif_offset = header_bytes + len(_directory(image, 0))
    strip_offset = exif_offset + len(_directory(exif, 0))
    image[273] = _numbers(_LONG, strip_offset)
    image[34665] = _numbers(_LONG, exif_offset)
    return b"".join(
        (
            struct.pack("<2sHI", b"II", 42, header_bytes),
            _directory(image, header_bytes),
            _directory(exif, exif_offset),
            frame.data,
        )
    )


def _framed(mosaic: NDArray[np.uint16], black: int) -> NDArray[np.uint16]:
    """The mosaic with a black border where it is too small for LibRaw."""
    height, width = mosaic.shape
    frame_height, frame_width = height, width
    if min(height, width) < MIN_SIDE:
        # A border on both sides, as LibRaw overlooks a crop that spans the whole width or height.
        frame_height, frame_width = max(height + 2, MIN_SIDE), max(width + 2, MIN_SIDE)
    frame = np.full((frame_height, frame_width), black, dtype="<u2")
    frame[:height, :width] = mosaic
    return frame


def _exif(iso: int, exposure_s: float, f_number: float | None, date: datetime) -> dict[int, _Field]:
    """Tags of the EXIF directory."""
    when = _when(date)
    tags: dict[int, _Field] = {
        33434: _numbers(_RATIONAL, *_ratio(exposure_s)),  # ExposureTime
        34855: _numbers(_SHORT, iso),  # PhotographicSensitivity
        36864: (_UNDEFINED, 4, b"0230"),  # ExifVersion
        36867: _text(when),  # DateTimeOriginal
        36868: _text(when),  # DateTimeDigitized
    }
    if f_number is not None:
        tags[33437] = _numbers(_RATIONAL, *_ratio(f_number))  # FNumber
    return tags


def _image(
    frame: NDArray[np.uint16],
    crop: tuple[int, ...],
    black: int,
    white: int,
    model: str,
    date: datetime,
    as_shot_neutral: tuple[float, float, float],
) -> dict[int, _Field]:
    """Tags of the image directory; both offsets are set when its length is known."""
    frame_height, frame_width = frame.shape
    height, width = crop
    return {
        254: _numbers(_LONG, 0),  # NewSubfileType: the full image
        256: _numbers(_LONG, frame_width),
        257: _numbers(_LONG, frame_height),
        258: _numbers(_SHORT, 16),  # BitsPerSample
        259: _numbers(_SHORT, 1),  # Compression: none
        262: _numbers(_SHORT, 32803),  # PhotometricInterpretation: colour filter array
        271: _text("pdcd"),  # Make
        272: _text(model),
        273: _numbers(_LONG, 0),  # StripOffsets, set once the directories' length is known
        274: _numbers(_SHORT, 1),  # Orientation: as stored
        277: _numbers(_SHORT, 1),  # SamplesPerPixel
        278: _numbers(_LONG, frame_height),  # RowsPerStrip
        279: _numbers(_LONG, frame.nbytes),  # StripByteCounts
        284: _numbers(_SHORT, 1),  # PlanarConfiguration
        306: _text(_when(date)),  # DateTime
        33421: _numbers(_SHORT, 2, 2),  # CFARepeatPatternDim
        33422: _numbers(_BYTE, 0, 1, 1, 2),  # CFAPattern: RGGB
        34665: _numbers(_LONG, 0),  # ExifIFD, set below
        50706: _numbers(_BYTE, 1, 4, 0, 0),  # DNGVersion
        50707: _numbers(_BYTE, 1, 1, 0, 0),  # DNGBackwardVersion
        50708: _text(model),  # UniqueCameraModel
        50711: _numbers(_SHORT, 1),  # CFALayout: rectangular
        50713: _numbers(_SHORT, 2, 2),  # BlackLevelRepeatDim
        50714: _numbers(_LONG, *[black] * 4),  # BlackLevel
        50717: _numbers(_LONG, white),  # WhiteLevel
        50719: _numbers(_LONG, 0, 0),  # DefaultCropOrigin
        50720: _numbers(_LONG, width, height),  # DefaultCropSize
        50721: _numbers(_SRATIONAL, *[n for entry in _XYZ_TO_CAMERA for n in (entry, 10000)]),
        50728: _numbers(_RATIONAL, *[n for value in as_shot_neutral for n in _ratio(value)]),
        50778: _numbers(_SHORT, _D65),  # CalibrationIlluminant1
    }


def _when(date: datetime) -> str:
    return f"{date:%Y:%m:%d %H:%M:%S}"


def _odd(shape: Sequence[int]) -> bool:
    return any(side % 2 for side in shape)


def _ratio(value: float) -> tuple[int, int]:
    """Closest fraction whose numerator and denominator fit TIFF's 32 bits (values below 4294)."""
    fraction = Fraction(value).limit_denominator(1_000_000)
    return fraction.numerator, fraction.denominator


def _numbers(kind: int, *values: int) -> _Field:
    """Field of numbers; rationals are given as numerator, denominator, numerator, ..."""
    packing = _PACKING[kind]
    packed = struct.pack("<" + str(len(values)) + packing[0], *values)
    return kind, len(values) // len(packing), packed


def _text(text: str) -> _Field:
    """Field of NUL-terminated ASCII; other letters become question marks."""
    packed = text.encode("ascii", "replace") + b"\0"
    return _ASCII, len(packed), packed


def _directory(fields: dict[int, _Field], offset: int) -> bytes:
    """One IFD that will lie at `offset`, with the values that do not fit its entries behind it."""
    entries = struct.pack("<H", len(fields))
    values = b""
    values_offset = offset + 2 + 12 * len(fields) + 4
    for tag, (kind, count, packed) in sorted(fields.items()):
        entries += struct.pack("<HHI", tag, kind, count)
        if len(packed) <= 4:
            entries += packed.ljust(4, b"\0")
        else:
            entries += struct.pack("<I", values_offset + len(values))
            values += packed + b"\0" * (len(packed) % 2)  # TIFF: values begin on even offsets
    return entries + struct.pack("<I", 0) + values
