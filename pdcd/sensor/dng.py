"""A minimal DNG writer: the RAW file of a camera that hands over samples, and of the virtual one.

A DNG is a TIFF: a header, one directory (IFD) of tags for the image, one for the EXIF data, and
the samples. Only what RAW decoders need is written: little-endian, one uncompressed strip of 16-bit
samples, a Bayer mosaic or one grey plane, DNG version 1.4. Not modelled: previews, lossless
compression, lens and maker data.

LibRaw 0.22 and dcraw 9.28 refuse images below 22 samples a side, ActiveArea included, so a smaller
mosaic is laid into the corner of a frame of black-level samples and described by DefaultCropSize,
which `pdcd.sensor.raw` follows.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from fractions import Fraction
from numbers import Integral, Real
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.devices import PhotoFrame, RawFile
from pdcd.errors import ConfigError, ExposureError, disk_errors
from pdcd.sensor.dng_form import BAYER

MIN_SIDE = 22
"""Least width and height, in samples, of a RAW image that LibRaw accepts."""

# TIFF field types that are used here: number in the file, and how one value is packed.
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _UNDEFINED, _SRATIONAL = 1, 2, 3, 4, 5, 7, 10
_PACKING = {_BYTE: "B", _SHORT: "H", _LONG: "I", _RATIONAL: "II", _SRATIONAL: "ii"}

# CIE XYZ to the camera's primaries under D65: those of linear sRGB (IEC 61966-2-1), in 1e-4.
_XYZ_TO_CAMERA = (32406, -15372, -4986, -9689, 18758, 415, 557, -2040, 10570)
_D65 = 21

_MAX_ISO = 65535  # what EXIF's PhotographicSensitivity holds
_MAX_DN = 65535  # what 16 bits hold
_MAX_RATIO = 2.0**31  # of a TIFF rational, with room to spare
_LEAST_F = 1e-6

_Field = tuple[int, int, bytes]  # type, count, value


def write_dng(
    path: Path,
    samples: NDArray[np.uint16],
    *,
    black: int | Sequence[int],
    white: int,
    iso: int,
    exposure_s: float,
    model: str,
    cfa: str | None = "RGGB",
    f_number: float | None = None,
    make: str = "pdcd",
    serial: str = "",
    date: datetime | None = None,
    as_shot_neutral: tuple[float, float, float] = (1.0, 1.0, 1.0),
    record: Mapping[str, str] = MappingProxyType({}),
) -> RawFile:
    """Write samples of a sensor as an uncompressed DNG, and say what `Readout.fetch` returns.

    For drivers of cameras that hand over samples and not files.

    Parameters
    ----------
    path : where to write; a file that is there is replaced.
    samples : (H, W) uint16
        In DN, as the sensor gives them: black not taken off, nothing scaled, turned or mended. H
        and W are even, except for a sensor without colours.
    black : DN
        Level without light: one whole number, or one for each place of the quad, row by row.
    white : DN
        Level from which a sample is saturated.
    iso, exposure_s, f_number
        What the photo was taken with; ISO 0 stands for none, and `f_number` None (the lens does not
        report it) is left out.
    model, make, serial
        Which camera it was; "" leaves the serial number out.
    cfa : "RGGB", "BGGR", "GRBG", "GBRG" or None
        Colours of the quad at the upper left corner, row by row; None: one grey plane. Cutting out
        an odd number of rows or columns, or mirroring, turns one order into another.
    date : when it was taken, to the second; None: now.
    as_shot_neutral : response (R, G, B) to a neutral surface, the inverse of the white balance.
    record : what the device reported for this photo, kept in the file as JSON (ImageDescription).

    Raises ConfigError for samples or numbers that no DNG can hold, NoSpaceError and DiskError. A
    file that could not be written whole is removed.
    """
    data = encode_dng(
        samples, black=black, white=white, iso=iso, exposure_s=exposure_s, f_number=f_number,
        make=make, model=model, serial=serial, cfa=cfa, date=date or datetime.now(UTC),
        as_shot_neutral=as_shot_neutral, record=record,
    )  # fmt: skip
    _write_whole(path, data)
    return RawFile(path, len(data), hashlib.sha256(data).hexdigest())


def _write_whole(path: Path, data: bytes) -> None:
    with disk_errors("camera"):
        try:
            path.write_bytes(data)
        except OSError:
            path.unlink(missing_ok=True)
            raise


def keep_photo(
    photo: RawFile | PhotoFrame, path: Path, model: str, serial: str, *, hold: bool = False
) -> tuple[RawFile, dict[str, bytes]]:
    """The file of a photo that `Readout.fetch` returned: its own, or `path` for one in memory. With
    `hold` nothing is written; the bytes of the files are returned by name.

    Raises what `write_dng` raises, and ExposureError for anything that is not a photo.
    """
    if isinstance(photo, RawFile) and photo.path.parent == path.parent:
        return photo, {}
    if not isinstance(photo, PhotoFrame):
        raise ExposureError(
            f"the camera's driver handed over {photo!r:.80}, which is no photo of this run",
            device="camera",
            hint="fetch returns a RawFile in the folder it was given, or a PhotoFrame",
        )
    if hold:
        return hold_photo_frame(photo, path, model, serial)
    return write_photo_frame(photo, path, model, serial), {}


def write_photo_frame(frame: PhotoFrame, path: Path, model: str, serial: str) -> RawFile:
    """Write a photo that a camera handed over; that of a second bucket goes into a file beside it.

    The rig calls it with what `Readout.fetch` returned, so that a run has its RAW files. Raises
    what `write_dng` raises.
    """
    raw, held = hold_photo_frame(frame, path, model, serial)
    for name, data in held.items():
        _write_whole(path.with_name(name), data)
    return raw


def hold_photo_frame(
    frame: PhotoFrame, path: Path, model: str, serial: str
) -> tuple[RawFile, dict[str, bytes]]:
    """What `write_photo_frame` would return, and the bytes that it would write, by file name.

    For a rig that keeps no files. Raises ConfigError for samples or numbers that no DNG can hold.
    """
    second, held = None, dict[str, bytes]()
    if frame.second is not None:
        beside = path.with_name(f"{path.stem}-second{path.suffix}")
        second, held = hold_photo_frame(frame.second, beside, model, serial)
    data = encode_dng(
        frame.samples,
        black=frame.black,
        white=frame.white,
        iso=frame.iso,
        exposure_s=frame.exposure_s,
        f_number=frame.f_number,
        cfa=frame.cfa,
        model=model,
        serial=serial,
        date=frame.date or datetime.now(UTC),
        record=frame.record,
    )
    digest = hashlib.sha256(data).hexdigest()
    return RawFile(path, len(data), digest, second), {**held, path.name: data}


def encode_dng(
    samples: NDArray[np.uint16],
    *,
    black: int | Sequence[int],
    white: int,
    iso: int,
    exposure_s: float,
    f_number: float | None,
    model: str,
    date: datetime,
    cfa: str | None = "RGGB",
    make: str = "pdcd",
    serial: str = "",
    as_shot_neutral: tuple[float, float, float] = (1.0, 1.0, 1.0),
    record: Mapping[str, str] = MappingProxyType({}),
) -> bytes:
    """The whole file that `write_dng` writes, for virtual cameras that send it themselves.

    Raises ConfigError for samples or numbers that no DNG can hold.

    Source: TIFF 6.0; Adobe DNG specification 1.4, chapters 2 and 4; EXIF 2.3, section 4.6.
    """
    _check(samples, cfa)
    levels = _levels(black, white, cfa)
    _check_settings(iso, exposure_s, f_number)
    frame = _framed(samples, levels)
    exif = _exif(iso, exposure_s, f_number, date)
    image = _image(frame, samples.shape, white, date) | _identity(make, model, serial, record)
    image |= _colours(cfa, levels, as_shot_neutral)
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


def _check(samples: NDArray[np.uint16], cfa: str | None) -> None:
    if cfa is not None and cfa not in BAYER:
        raise ConfigError(
            f"no DNG is written of the mosaic {cfa!r}",
            device="camera",
            hint=f"take one of {', '.join(BAYER)}, or None for a sensor without colours",
        )
    if not isinstance(samples, np.ndarray):
        raise ConfigError(
            f"a DNG needs an array of samples, not {type(samples).__name__}",
            device="camera",
            hint="give a numpy array (rows, columns) uint16",
        )
    shape = samples.shape
    whole = samples.ndim == 2 and 0 not in shape and (cfa is None or not _odd(shape))
    if samples.dtype != np.uint16 or not whole:
        sides = "an (even, even) uint16 mosaic" if cfa else "a (rows, columns) uint16 plane"
        raise ConfigError(
            f"a DNG needs {sides}, not {shape} {samples.dtype}",
            device="camera",
            hint="give whole Bayer quads" if cfa else "give one plane of samples",
        )


def _check_settings(iso: int, exposure_s: float, f_number: float | None) -> None:
    """Refuse settings that no photo can have been taken with."""
    if not isinstance(iso, Integral) or not 0 <= iso <= _MAX_ISO:
        raise ConfigError(
            f"ISO {iso!r:.40} does not fit the tag",
            device="camera",
            hint=f"take 1 to {_MAX_ISO}, or 0 for none",
        )
    for what, value, least in (("exposure_s", exposure_s, 0.0), ("f_number", f_number, _LEAST_F)):
        if value is None and what == "f_number":
            continue
        if not isinstance(value, Real) or not least <= value <= _MAX_RATIO:
            raise ConfigError(
                f"{what} {value!r:.40} of a photo does not fit its tag",
                device="camera",
                hint=f"give a number from {least:g} to {_MAX_RATIO:g}",
            )


def _levels(black: int | Sequence[int], white: int, cfa: str | None) -> tuple[int, ...]:
    """Black of each place of the quad, row by row; one level for a grey plane."""
    places = 4 if cfa else 1
    levels = tuple(black) if isinstance(black, Sequence | np.ndarray) else (black,) * places
    whole = all(isinstance(level, Integral) for level in (*levels, white))
    if len(levels) != places or not whole or min(levels) < 0:
        raise ConfigError(
            f"black levels {list(levels)} for {places} places of the quad",
            device="camera",
            hint="give one whole number that is not negative, or one for each place",
        )
    if not max(levels) < white <= _MAX_DN:
        raise ConfigError(
            f"a white level of {white} DN above a black of {max(levels)} DN",
            device="camera",
            hint=f"give black below white, and white of at most {_MAX_DN}",
        )
    return levels


def _framed(samples: NDArray[np.uint16], levels: tuple[int, ...]) -> NDArray[np.uint16]:
    """The samples with a black border where they are too few for LibRaw."""
    height, width = samples.shape
    frame_height, frame_width = height, width
    if min(height, width) < MIN_SIDE:
        # A border on both sides, as LibRaw overlooks a crop that spans the whole width or height.
        frame_height, frame_width = max(height + 2, MIN_SIDE), max(width + 2, MIN_SIDE)
    side = 2 if len(levels) == 4 else 1
    frame = np.empty((frame_height, frame_width), dtype="<u2")
    for place, level in enumerate(levels):
        frame[place // side :: side, place % side :: side] = level
    frame[:height, :width] = samples
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
    frame: NDArray[np.uint16], crop: tuple[int, ...], white: int, date: datetime
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
        273: _numbers(_LONG, 0),  # StripOffsets, set once the directories' length is known
        274: _numbers(_SHORT, 1),  # Orientation: as stored
        277: _numbers(_SHORT, 1),  # SamplesPerPixel
        278: _numbers(_LONG, frame_height),  # RowsPerStrip
        279: _numbers(_LONG, frame.nbytes),  # StripByteCounts
        284: _numbers(_SHORT, 1),  # PlanarConfiguration
        306: _text(_when(date)),  # DateTime
        34665: _numbers(_LONG, 0),  # ExifIFD, set with the other
        50706: _numbers(_BYTE, 1, 4, 0, 0),  # DNGVersion
        50707: _numbers(_BYTE, 1, 1, 0, 0),  # DNGBackwardVersion
        50717: _numbers(_LONG, white),  # WhiteLevel
        50719: _numbers(_LONG, 0, 0),  # DefaultCropOrigin
        50720: _numbers(_LONG, width, height),  # DefaultCropSize
    }


def _identity(make: str, model: str, serial: str, record: Mapping[str, str]) -> dict[int, _Field]:
    """Tags that say which camera it was, and what it reported."""
    tags = {271: _text(make), 272: _text(model), 50708: _text(model)}  # the last: UniqueCameraModel
    if serial:
        tags[50735] = _text(serial)  # CameraSerialNumber
    if record:
        tags[270] = _text(json.dumps(dict(record)))  # ImageDescription
    return tags


def _colours(
    cfa: str | None, levels: tuple[int, ...], as_shot_neutral: tuple[float, float, float]
) -> dict[int, _Field]:
    """Tags of the mosaic and its colours, or of a grey plane."""
    side = 2 if cfa else 1
    tags = {
        50713: _numbers(_SHORT, side, side),  # BlackLevelRepeatDim
        50714: _numbers(_LONG, *levels),  # BlackLevel
    }
    if cfa is None:
        return tags | {262: _numbers(_SHORT, 34892)}  # PhotometricInterpretation: linear RAW
    return tags | {
        262: _numbers(_SHORT, 32803),  # PhotometricInterpretation: colour filter array
        33421: _numbers(_SHORT, 2, 2),  # CFARepeatPatternDim
        33422: _numbers(_BYTE, *("RGB".index(colour) for colour in cfa)),  # CFAPattern
        50711: _numbers(_SHORT, 1),  # CFALayout: rectangular
        50721: _numbers(_SRATIONAL, *[n for entry in _XYZ_TO_CAMERA for n in (entry, 10000)]),
        50728: _numbers(_RATIONAL, *[n for value in as_shot_neutral for n in _ratio(value)]),
        50778: _numbers(_SHORT, _D65),  # CalibrationIlluminant1
    }


def _when(date: datetime) -> str:
    return f"{date:%Y:%m:%d %H:%M:%S}"


def _odd(shape: Sequence[int]) -> bool:
    return any(side % 2 for side in shape)


def _ratio(value: float) -> tuple[int, int]:
    """Closest fraction whose numerator and denominator fit TIFF's 32 bits."""
    most = max(min(1_000_000, int((2**32 - 1) / max(float(value), 1.0))), 1)
    fraction = Fraction(float(value)).limit_denominator(most)
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
    """One IFD that will lie at `offset`, followed by the values that do not fit its entries."""
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
