"""RAW file -> linear, signed colour planes: the measurement path.

The samples are taken as the file has them, minus black, and nothing else is done: no white balance,
no scaling by the frame's own maximum, no clipping of noise below black, no demosaicing. Photos that
will be subtracted from each other would be spoilt by each of these; they come last, in
`pdcd.develop`.
"""

from __future__ import annotations

import hashlib
import io
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rawpy
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.sensor import SensorProfile, variance_dn2

_LIBRAW_MIN_SIDE = 22
_TIFF_MODEL = 272


@dataclass(frozen=True)
class RawFrame:
    """One decoded photo; one pixel per Bayer quad.

    planes : (4, h, w) float32
        R, G1 (the green of the red rows), G2, B: samples in DN minus black, signed.
    saturated : (h, w) bool
        True where any sample of the quad is at or above saturation.
    black : (4,) float64
        Black level in DN that was taken off each plane.
    white : float
        Highest value of a sample in DN, black included.
    iso, exposure_s, f_number, model
        What the file says of itself; 0, 0.0, None and "" where it says nothing.
    pattern : str
        Colours of the quad in the file, row by row, e.g. "RGGB".
    """

    planes: NDArray[np.float32]
    saturated: NDArray[np.bool_]
    black: NDArray[np.float64]
    white: float
    iso: int
    exposure_s: float
    f_number: float | None
    model: str
    pattern: str


def read_raw(
    path: Path,
    *,
    sha256: str | None = None,
    size_bytes: int | None = None,
    saturation_dn: float | None = None,
) -> RawFrame:
    """Decode a RAW file of a camera with a 2x2 Bayer mosaic.

    Parameters
    ----------
    path
        Any RAW format LibRaw knows. Of an image with an odd number of rows or columns the last one
        is left out. The orientation tag is ignored: pixels stay where the sensor has them.
    sha256, size_bytes
        What the file must be, as announced when it was fetched. LibRaw alone notices a truncated
        file, but neither a damaged one nor the loss of the very last byte.
    saturation_dn
        Signal in DN above black from which a sample counts as saturated
        (`SensorProfile.saturation_dn`); the file's white level counts in any case.

    Raises
    ------
    DecodeError
        The file cannot be read, is not the announced one, is damaged, or has no Bayer mosaic.
    """
    data = _read_checked(path, sha256, size_bytes)
    try:
        with rawpy.imread(io.BytesIO(data)) as raw:
            return _frame(raw, path, _tiff_model(data), saturation_dn)
    except rawpy.LibRawError as err:
        reason = err.args[0].decode() if err.args and isinstance(err.args[0], bytes) else str(err)
        raise DecodeError(
            f"cannot decode {path.name}: {reason}",
            hint="the file is truncated, damaged or no RAW file; fetch it from the camera again",
        ) from err


def _read_checked(path: Path, sha256: str | None, size_bytes: int | None) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as err:
        raise DecodeError(f"cannot read {path}: {err.strerror}") from err
    again = "fetch it from the camera again"
    if size_bytes is not None and len(data) != size_bytes:
        raise DecodeError(f"{path.name} has {len(data)} bytes, not {size_bytes}", hint=again)
    if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256.lower():
        raise DecodeError(f"{path.name} does not have the SHA-256 it was fetched with", hint=again)
    return data


def _frame(raw: rawpy.RawPy, path: Path, model: str, saturation_dn: float | None) -> RawFrame:
    """Planes and metadata of an open file; everything is copied, as LibRaw's memory goes away."""
    pattern = raw.raw_pattern
    letters = raw.color_desc.decode()
    colours = "" if pattern is None else "".join(letters[index] for index in pattern.ravel())
    if pattern is None or colours not in ("RGGB", "BGGR", "GRBG", "GBRG"):
        raise DecodeError(
            f"{path.name} has no 2x2 Bayer mosaic of red, green and blue",
            hint="set the camera to full-size RAW",
        )
    mosaic = raw.raw_image_visible
    sizes = raw.sizes
    if 0 < min(sizes.crop_width, sizes.crop_height) < _LIBRAW_MIN_SIDE:
        # LibRaw refuses so small an image; the mock camera sends a larger one and says by its crop
        # which corner counts. Crops of real cameras only trim the edge and are not applied.
        mosaic = mosaic[: sizes.crop_height, : sizes.crop_width]
    height, width = mosaic.shape[0] // 2, mosaic.shape[1] // 2
    black = np.empty(4, dtype=np.float64)
    planes = np.empty((4, height, width), dtype=np.float32)
    for plane, (row, column) in enumerate(_quad(colours)):
        black[plane] = raw.black_level_per_channel[pattern[row, column]]
        planes[plane] = mosaic[row : 2 * height : 2, column : 2 * width : 2]
        planes[plane] -= black[plane]
    white = float(raw.white_level)
    limit = white - black
    if saturation_dn is not None:
        limit = np.minimum(limit, saturation_dn)
    return RawFrame(
        planes=planes,
        saturated=np.any(planes >= limit[:, None, None], axis=0),
        black=black,
        white=white,
        iso=round(raw.other.iso_speed),
        exposure_s=_single(raw.other.shutter_speed),
        f_number=_single(raw.other.aperture) or None,
        model=model,
        pattern=colours,
    )


def _quad(colours: str) -> list[tuple[int, int]]:
    """(row, column) within the quad of R, G1, G2, B, where G1 shares its row with R."""
    red, blue = divmod(colours.index("R"), 2), divmod(colours.index("B"), 2)
    return [red, (red[0], blue[1]), (blue[0], red[1]), blue]


def _single(value: float) -> float:
    """Shortest decimal of a value LibRaw holds in single precision: 25.6, not 25.600000381."""
    return float(str(np.float32(value)))


def _tiff_model(data: bytes) -> str:
    """Camera model of a file built on TIFF (DNG, CR2, NEF, ARW); "" of others. LibRaw's Python
    binding does not give it."""
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None:
        return ""
    try:
        (directory,) = struct.unpack_from(order + "I", data, 4)
        (entries,) = struct.unpack_from(order + "H", data, directory)
        for entry in range(directory + 2, directory + 2 + 12 * entries, 12):
            tag, _, length, offset = struct.unpack_from(order + "HHII", data, entry)
            if tag == _TIFF_MODEL:
                start = offset if length > 4 else entry + 8
                return data[start : start + length].split(b"\0")[0].decode("ascii", "replace")
    except struct.error:  # other formats that begin like TIFF
        pass
    return ""


def to_rgb(planes: NDArray[np.float32]) -> NDArray[np.float64]:
    """(4, h, w) planes R, G1, G2, B -> (h, w, 3) float64, the two greens averaged."""
    red, green1, green2, blue = planes.astype(np.float64)
    return np.stack([red, (green1 + green2) / 2.0, blue], axis=-1)


def rgb_variance(
    planes: NDArray[np.float32], profile: SensorProfile, iso: int, exposure_s: float
) -> NDArray[np.float64]:
    """Variance of `to_rgb(planes)` by the sensor's noise model: (h, w, 3) float64, DN squared.

    The measured samples stand in for the expected ones, so that the photon part is itself noisy
    (and a little high where there is no light). Raises `ConfigError` for an unknown ISO.
    """
    red, green1, green2, blue = variance_dn2(planes, profile, iso, exposure_s)
    return np.stack([red, (green1 + green2) / 4.0, blue], axis=-1)
