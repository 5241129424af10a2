"""RAW file -> linear, signed colour planes: the measurement path.

The samples are taken as the file has them, minus black, and nothing else is done: no white balance,
no scaling by the frame's own maximum, no clipping of noise below black, no demosaicing. Each of
these would spoil photos that are subtracted from each other; they come last, in
`pdcd.pictures.written.picture_files`.

Black comes from the masked border where the file has a dark one: columns of the sensor that no
light reaches, exposed with the picture. A number in the file's tags does not depend on that
exposure. `pdcd.sensor.mosaic` finds both, and reports where two values of one level disagree.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import MAX_RAW_BYTES, read_file
from pdcd.sensor.bands import run_in_bands
from pdcd.sensor.colours import OF_COLOURS
from pdcd.sensor.mosaic import (
    Mosaic,
    RawInput,
    find_picture,
    is_grey,
    open_raw,
    read_exposure,
    read_mosaic,
    read_tagged_exposure,
)
from pdcd.sensor.proof import check_hole, check_samples, check_zeros
from pdcd.sensor.tiff import DATE_TAKEN, MODEL
from pdcd.sensor.whole import measure_hole

RAW_SUFFIXES = (".cr2", ".cr3", ".dng", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef")
"""Suffixes of RAW files, in lower case."""

WHOLE_AXIS = slice(None)
"""All rows, or all columns."""
_NEARLY_WHITE = 0.9
"""Share of the white level above which samples may clip without reaching it."""
_FEWER_BITS = range(8, 16)
_FEWEST_CLIPPED, _CLIPPED_TIMES = 16, 8
"""Least number of samples at the highest value that shows clipping, and their least ratio to those
at the next lower value: noise alone never gives so many."""


@dataclass(frozen=True)
class RawFrame:
    """One decoded photo; one pixel per Bayer quad, or per sample of a sensor without colours.

    samples : (P, h, w) uint16
        4 planes R, G1 (the green of the red rows), G2, B in DN, black included (`planes` has it
        taken off); 1 plane for a sensor without colours. float32 where the file's samples are real
        numbers or wider, and where black differs within a plane: there the difference from the
        plane's `black` is taken off.
    saturated : (h, w) bool
        True where any sample of the quad is at or above saturation.
    black : (P,) float64
        Black level in DN that is taken off each plane: the mean of the masked border, or else what
        the tags of a DNG say, or LibRaw.
    libraw_black : (P,) float64
        Black level in DN by LibRaw: from tags, or its own mean of a border, cut to whole numbers.
        It equals `black` where LibRaw does not read the file.
    masked, tagged : bool
        Whether black is that of a masked border; whether it is that of tags which LibRaw reads
        differently.
    white : float
        Highest value of a sample in DN, black included.
    iso, exposure_s, f_number, model, date
        What the file says of itself; 0, 0.0, None, "" and "" where it says nothing.
    flip : int
        How a viewer would turn the picture: 0 not at all, 3 by 180 degrees, 5 by 90 to the left,
        6 by 90 to the right. The planes are not turned: pixels stay where the sensor has them.
    pattern : str
        Colours of the quad in the file, row by row, e.g. "RGGB"; "" for a sensor without colours.
    side : int
        Quads of the file, each way, whose mean is one quad here; `samples` are float32 where it is
        more than 1.
    doubts : tuple
        What the user should know about this file's levels, in words.
    """

    samples: NDArray[np.uint16] | NDArray[np.float32]
    saturated: NDArray[np.bool_]
    black: NDArray[np.float64]
    libraw_black: NDArray[np.float64]
    masked: bool
    white: float
    iso: int
    exposure_s: float
    f_number: float | None
    model: str
    date: str
    flip: int
    pattern: str
    side: int = 1
    tagged: bool = False
    doubts: tuple[str, ...] = ()

    @property
    def frame(self) -> tuple[int, int]:
        """Rows and columns of pixels."""
        return int(self.samples.shape[1]), int(self.samples.shape[2])

    @property
    def colours(self) -> int:
        """Number of colours: 3, or 1 for a sensor without colours."""
        return len(OF_COLOURS[len(self.samples)])

    @property
    def planes(self) -> NDArray[np.float32]:
        """(P, h, w), samples minus black, signed, in DN; computed anew every time."""
        return self.signal()

    def signal(self, rows: slice = WHOLE_AXIS, columns: slice = WHOLE_AXIS) -> NDArray[np.float32]:
        """The same for some rows and columns of quads."""
        black = self.black.astype(np.float32)[:, None, None]
        return np.subtract(self.samples[:, rows, columns], black, dtype=np.float32)

    def without(self, quads: NDArray[np.bool_]) -> RawFrame:
        """The photo with these quads (h, w) marked as saturated, too."""
        return replace(self, saturated=self.saturated | quads)

    def binned(self, side: int, dead: NDArray[np.bool_] | None = None) -> RawFrame:
        """The photo with squares of `side` x `side` quads in place of single quads. Rows and
        columns are multiples of `side`.

        dead : (h, w), quads marked as saturated that do not follow the light. They are left out of
        the mean if at least half of the square is left. A square with a quad that light saturated
        is saturated: that quad is its brightest, and the mean without it would be too low.
        """
        rows, cols = (length // side for length in self.frame)
        samples = np.zeros((len(self.samples), rows, cols), np.float32)
        saturated = np.empty((rows, cols), np.bool_)

        def band(some: slice) -> None:
            fine = slice(side * some.start, side * some.stop)
            good = ~self.saturated[fine]
            full = self.saturated[fine] if dead is None else self.saturated[fine] & ~dead[fine]
            share = shrink_image(good.astype(np.float32), side)
            for plane in range(len(samples)):
                light = np.where(good, self.samples[plane, fine], np.float32(0.0))
                mean = shrink_image(light, side)
                np.divide(mean, share, out=samples[plane, some], where=share > 0.0)
            saturated[some] = (share < 0.5) | (shrink_image(full.astype(np.float32), side) > 0.0)

        run_in_bands(rows, band)
        return replace(self, samples=samples, saturated=saturated, side=self.side * side)

    def exif(self) -> dict[str, object]:
        """What the manifest records of the photo."""
        black_from = "masked border" if self.masked else "tags" if self.tagged else "LibRaw"
        return {
            "model": self.model,
            "date": self.date,
            "iso": self.iso,
            "exposure_s": self.exposure_s,
            "f_number": self.f_number,
            "flip": self.flip,
            "black_dn": self.black.tolist(),
            "black_from": black_from,
            "libraw_black_dn": self.libraw_black.tolist(),
            "white_dn": self.white,
            **({"doubts": list(self.doubts)} if self.doubts else {}),
        }


def read_raw(
    path: Path,
    *,
    sha256: str | None = None,
    size_bytes: int | None = None,
    saturation_dn: float | None = None,
    most_samples: int | None = None,
    data: bytes | None = None,
) -> RawFrame:
    """Decode a RAW file of a camera with a 2x2 Bayer mosaic, or without colours.

    Parameters
    ----------
    path
        Any RAW format LibRaw knows. The last row or column of an odd number is left out, and so are
        masked borders. A DNG's image is its ActiveArea, wherever that begins; where the image of
        another format begins amid a quad, LibRaw leaves out the first row or column. The
        orientation tag is not followed.
    sha256, size_bytes
        What the file must be, as announced when it was fetched. Without them a file is refused only
        if it is shorter than its headers say, or has impossible samples; other damage goes
        unnoticed.
    saturation_dn
        Signal in DN above black from which a sample counts as saturated
        (`SensorProfile.saturation_dn`); the file's white level counts in any case.
    most_samples
        More samples than this are not unpacked: a small file may hold gigabytes of one number.
    data
        The file's bytes, where it exists only in memory and `path` is just its name.

    Raises
    ------
    DecodeError
        The file cannot be read, is not the announced one, is not whole or damaged, or has another
        mosaic; the message names what it has.
    """
    data = _read_checked(path, sha256, size_bytes, data)
    with open_raw(data, path.name) as raw:
        sizes = raw.libraw.sizes
        rows, columns = raw.form.shape if raw.form else (sizes.raw_height, sizes.raw_width)
        if most_samples is not None and rows * columns > most_samples:
            raise DecodeError(
                f"cannot decode {raw.name}: it has {columns} x {rows} samples, more than the "
                f"{most_samples} allowed",
                hint="is camera.profile that of this body?",
            )
        mosaic = read_mosaic(raw)
        frame = _with_clipped_samples(_frame(raw, mosaic, saturation_dn))
        odd = _check_frame(raw, mosaic, frame)
        return replace(frame, doubts=(*frame.doubts, *odd)) if odd else frame


@dataclass(frozen=True)
class RawHead:
    """What a RAW file says of its picture before its samples are unpacked.

    frame, flip, model : as in `RawFrame`.
    masked : (rows, columns) of samples of the sensor that lie beyond the picture, masked borders
        among them.
    colours : as in `RawFrame`.
    iso, exposure_s, f_number : as in `RawFrame`; a file that is not built on TIFF is unpacked for
        them.
    """

    frame: tuple[int, int]
    flip: int
    model: str
    masked: tuple[int, int]
    exposure_s: float = 0.0
    colours: int = 3
    iso: int = 0
    f_number: float | None = None

    @property
    def turned(self) -> str:
        """The orientation in words."""
        known = {0: "upright", 3: "turned by 180", 5: "turned by 90 left", 6: "turned by 90 right"}
        return known.get(self.flip, f"flip {self.flip}")


def read_raw_head(path: Path, *, sha256: str | None = None, data: bytes | None = None) -> RawHead:
    """Size, orientation and camera of a RAW file, without its samples: some milliseconds.

    sha256, data : as of `read_raw`. Raises DecodeError.
    """
    data = _read_checked(path, sha256, None, data)
    with open_raw(data, path.name) as raw:
        sizes, tags = raw.libraw.sizes, raw.tags
        (height, width), grey = find_picture(raw)[1], is_grey(raw)
        side = 1 if grey else 2
        if tags is None:
            raw.libraw.unpack()  # LibRaw reports the exposure time no earlier
        said = read_exposure(raw) if tags is None else read_tagged_exposure(tags)
    return RawHead(
        frame=(height // side, width // side),
        flip=sizes.flip,
        model=tags.text(MODEL) if tags else "",
        masked=(sizes.raw_height - sizes.height, sizes.raw_width - sizes.width),
        exposure_s=_single(said[1]),
        colours=1 if grey else 3,
        iso=said[0],
        f_number=said[2],
    )


def _read_checked(
    path: Path, sha256: str | None, size_bytes: int | None, data: bytes | None
) -> bytes:
    try:
        data = read_file(path, MAX_RAW_BYTES) if data is None else data
    except UnsoundFileError as err:
        raise DecodeError(f"cannot read {path}: {err.why}", hint=err.hint) from err
    again = "fetch it from the camera again"
    if size_bytes is not None and len(data) != size_bytes:
        raise DecodeError(f"{path.name} has {len(data)} bytes, not {size_bytes}", hint=again)
    if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256.lower():
        raise DecodeError(f"{path.name} does not have the SHA-256 it was fetched with", hint=again)
    return data


def _frame(raw: RawInput, mosaic: Mosaic, saturation_dn: float | None) -> RawFrame:
    """Planes and metadata of an open file; all is copied, as LibRaw frees its memory."""
    step = mosaic.step
    height, width = mosaic.size[0] // step, mosaic.size[1] // step
    sensor, uneven = mosaic.sensor, mosaic.uneven
    whole = uneven is None and sensor.dtype == np.uint16
    samples = np.empty((len(mosaic.places), height, width), np.uint16 if whole else np.float32)
    saturated = np.zeros((height, width), np.bool_)
    white = math.ceil(mosaic.white) if whole else mosaic.white
    top, left = mosaic.first

    def band(rows: slice) -> None:
        for plane, (row, column) in enumerate(mosaic.places):
            row, column = top + row, left + column
            there = sensor[row + step * rows.start : row + step * rows.stop : step]
            light = there[:, column : column + step * width : step]
            here = samples[plane, rows]
            here[...] = light
            saturated[rows] |= here >= white
            if uneven is not None:
                away = uneven[plane].of_rows(rows) - uneven[plane].mean
                np.subtract(light, away, out=here)
            if saturation_dn is not None:
                signal = np.subtract(here, np.float32(mosaic.black[plane]), dtype=np.float32)
                saturated[rows] |= signal >= np.float32(saturation_dn)

    run_in_bands(height, band)
    tags, (iso, exposure_s, f_number) = raw.tags, read_exposure(raw)
    return RawFrame(
        samples=samples,
        saturated=saturated,
        black=mosaic.black,
        libraw_black=mosaic.libraw_black,
        masked=mosaic.masked,
        white=mosaic.white,
        iso=iso,
        exposure_s=_single(exposure_s),
        f_number=_single(f_number or 0.0) or None,
        model=tags.text(MODEL) if tags else "",
        date=tags.text(DATE_TAKEN) if tags else "",
        flip=raw.libraw.sizes.flip,
        pattern=mosaic.colours,
        tagged=mosaic.tagged and not mosaic.masked,
        doubts=mosaic.doubts,
    )


def _with_clipped_samples(frame: RawFrame) -> RawFrame:
    """The photo with its highest samples marked as saturated, where samples clip below the white
    level: a little below, as 12 bits shifted left end at 65520, or at the highest number of fewer
    bits than stated. Far more samples then have that number than the next lower one."""
    most = float(frame.samples.max(initial=0))
    near = most >= _NEARLY_WHITE * frame.white or math.log2(most + 1.0) in _FEWER_BITS
    if not near or most >= frame.white:
        return frame
    clipped = frame.samples == most
    next_lower = frame.samples.max(where=~clipped, initial=0)
    least = _CLIPPED_TIMES * int(np.count_nonzero(frame.samples == next_lower))
    if np.count_nonzero(clipped) < max(_FEWEST_CLIPPED, least):
        return frame
    said = f"samples end at {most:g}, below white {frame.white:g}: these count as saturated"
    return replace(frame.without(clipped.any(axis=0)), doubts=(*frame.doubts, said))


def _check_frame(raw: RawInput, mosaic: Mosaic, frame: RawFrame) -> tuple[str, ...]:
    """Refuse samples that cannot be a photo's; return what is odd, in words. Raises DecodeError."""
    packed = raw.found.packed
    odd = check_samples(frame.samples, mosaic.black, mosaic.white, raw.name, packed=packed)
    # Cameras without noise write a DNG of whole numbers in one piece.
    plain = raw.form is not None and len(raw.form.pieces) == 1 and not raw.form.floating
    if not mosaic.black.any():
        odd += check_zeros(frame.samples, raw.name, packed=not plain)
    if hole := measure_hole(raw.data, raw.found):
        light, black = frame.samples, mosaic.black[:, None, None]
        clipped = light == light.max(axis=(1, 2), keepdims=True)  # others have noise
        even = int(np.count_nonzero(clipped | (light <= black + 1.0)))
        check_hole(hole, even, raw.name)
    return odd


def shrink_image(values: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Means of squares of `side` x `side` pixels of (h, w) or (h, w, C); `side` divides h and w."""
    size = values.shape[1] // side, values.shape[0] // side
    shrunk = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)
    return shrunk.reshape(size[1], size[0], *values.shape[2:])


def _single(value: float) -> float:
    """Shortest decimal of a value LibRaw holds in single precision: 25.6, not 25.600000381."""
    return float(str(np.float32(value)))
