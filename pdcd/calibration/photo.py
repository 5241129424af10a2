"""One photo of a calibration as its quads, and checks for what is wrong with it.

Lens caps, shutters that stay closed, clipped light and settings that somebody turned are recognised
here, for all steps that use the light of whole panels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.stops import are_same_stop
from pdcd.errors import CalibrationError
from pdcd.sensor.colours import compute_colour_variance, to_colours
from pdcd.sensor.profile import SensorProfile
from pdcd.sensor.raw import RawFrame

_Marks = NDArray[np.bool_]
_OfColour = TypeVar("_OfColour")

BLOCK_QUADS = 16
"""Side of the blocks that large pictures are worked on in."""
SMALL_FRAME_HINT = "set the camera to full-size RAW; for a mock bench, set camera.frame_quads"
_CLIPPED_SHARE = 1e-3
"""Share of saturated quads from which a photo is over-exposed; hot pixels stay below it."""
NO_LIGHT_SIGMAS = 8.0
BLACK_MOVES_DN = 1.5
"""Largest spread of black levels within a series; a border of 100 000 samples measures its mean to
0.05 DN."""
_BULB_S = 1.5
"""Cameras write the time of a bulb exposure in whole seconds."""


@dataclass(frozen=True, eq=False)
class QuadPhoto:
    """One photo, or the mean of several.

    light : (h, w, 3) float64, red, mean of both greens, blue of each Bayer quad, or (h, w, 1) of a
        sensor without colours; black level subtracted, in DN or any other unit proportional to
        light.
    variance : (h, w, C), of the light, in that unit squared.
    saturated : (h, w) bool, quads with a saturated sample; None where that is not known.
    """

    light: Floats
    variance: Floats
    saturated: _Marks | None = None

    def __post_init__(self) -> None:
        if self.light.shape[2:] not in ((3,), (1,)):
            raise ValueError(f"a photo is (h, w, 3 or 1), not {self.light.shape}")
        if self.variance.shape != self.light.shape:
            raise ValueError("light and variance of a photo differ in shape")
        if self.saturated is not None and self.saturated.shape != self.light.shape[:2]:
            raise ValueError("a photo and its saturated quads differ in shape")

    @property
    def frame(self) -> tuple[int, int]:
        """Rows and columns of quads."""
        return self.light.shape[0], self.light.shape[1]

    @property
    def colours(self) -> int:
        """3, or 1 of a sensor without colours."""
        return int(self.light.shape[2])

    @property
    def main(self) -> Floats:
        """(h, w), light of the colour by which things are found (`pick_main`)."""
        return np.asarray(self.light[..., self.colours // 2])

    @property
    def main_variance(self) -> Floats:
        """(h, w), of the same."""
        return np.asarray(self.variance[..., self.colours // 2])

    @property
    def shares(self) -> Floats:
        """(C,), share of a quad's samples in each colour."""
        return np.array([0.25, 0.5, 0.25] if self.colours == 3 else [1.0])

    def saturated_share(self, where: _Marks | None = None) -> float:
        """Share of saturated quads, of those marked or of all; 0 where that is not known."""
        if self.saturated is None:
            return 0.0
        marks = self.saturated if where is None else self.saturated[where]
        return float(marks.mean()) if marks.size else 0.0


@dataclass(frozen=True, eq=False)
class BlockMeans:
    """Means over square blocks of a photo.

    mean, variance : (rows, cols, C) float64, the mean light of a block and the variance of that.
    clipped : (rows, cols) float64, share of saturated quads.
    """

    mean: Floats
    variance: Floats
    clipped: Floats


@dataclass(frozen=True)
class RawSettings:
    """What a RAW file says of itself; 0, None and () where it says nothing."""

    iso: int = 0
    exposure_s: float = 0.0
    f_number: float | None = None
    black_dn: tuple[float, ...] = ()

    @classmethod
    def of(cls, raw: RawFrame) -> RawSettings:
        """The settings of a decoded photo; its black level only where a masked border measured
        it."""
        black = tuple(float(b) for b in raw.black) if raw.masked else ()
        return cls(raw.iso, raw.exposure_s, raw.f_number, black)


def pick_main(of_colours: Sequence[_OfColour]) -> _OfColour:
    """The one of the colour by which things are found: green, which has most samples, or the only
    one."""
    return of_colours[len(of_colours) // 2]


def make_quad_photo(raw: RawFrame, profile: SensorProfile, iso: int) -> QuadPhoto:
    """A decoded photo as its quads in DN, variances by the sensor's noise model. Raises ConfigError
    when the profile has no such ISO."""
    signal = raw.planes
    variance = compute_colour_variance(signal, profile, iso, raw.exposure_s)
    return QuadPhoto(to_colours(signal), np.asarray(variance, np.float64), raw.saturated)


def shrink_marks(marks: _Marks) -> _Marks:
    """Marked blocks whose neighbours are marked, too; blocks beyond the frame count as its edge
    does."""
    return np.asarray(cv2.erode(marks.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


def check_blocks_in_frame(frame: tuple[int, ...], side: int = BLOCK_QUADS) -> tuple[int, int]:
    """Rows and columns of whole blocks of a photo (rows, columns of quads). Raises CalibrationError
    where there is not one."""
    rows, cols = frame[0] // side, frame[1] // side
    if not rows or not cols:
        raise CalibrationError(
            f"a photo of {frame[1]} x {frame[0]} pixels is too small",
            device="camera",
            hint=f"at least {side} x {side} pixels are needed: {SMALL_FRAME_HINT}",
        )
    return rows, cols


def average_blocks(values: Floats, side: int = BLOCK_QUADS) -> Floats:
    """(h, w, ...) -> (h // side, w // side, ...): means of blocks; incomplete ones are left out.

    Raises CalibrationError where there is not one block.
    """
    rows, cols = check_blocks_in_frame(values.shape[:2], side)
    cut = values[: rows * side, : cols * side]
    return np.asarray(
        cut.reshape(rows, side, cols, side, *values.shape[2:]).mean(axis=(1, 3)), np.float64
    )


def average_photo_blocks(photo: QuadPhoto, side: int = BLOCK_QUADS) -> BlockMeans:
    """A photo by blocks of side x side quads. Raises as `average_blocks`."""
    return BlockMeans(
        average_blocks(photo.light, side),
        average_blocks(photo.variance, side) / side**2,
        average_blocks(_marks(photo).astype(np.float64), side),
    )


def _marks(photo: QuadPhoto) -> _Marks:
    return np.zeros(photo.frame, np.bool_) if photo.saturated is None else photo.saturated


def check_clipping(name: str, share: float, hint: str) -> None:
    """Raise CalibrationError where this share of a photo is saturated: over-exposed."""
    if share > _CLIPPED_SHARE:
        raise CalibrationError(
            f"photo {name} is saturated in {100.0 * share:.2g} % of the picture",
            device="camera",
            hint=hint,
        )


def check_brightness(levels: Mapping[str, float], floor: float) -> None:
    """Raise CalibrationError where photos that must show light are dark.

    levels : mean light of each photo that has a lit panel, by name.
    floor : above it there is light.
    """
    dark = sorted(name for name, level in levels.items() if level <= floor)
    if dark and len(dark) == len(levels):
        raise CalibrationError(
            "no photo shows any light",
            device="camera",
            hint="take the lens cap off; see that the projector is on, that the mask lets light "
            "through and that the shutter opens",
        )
    if dark:
        raise CalibrationError(
            f"photo {dark[0]} is dark, but others of the same light are not: the shutter did not "
            "open, or the panels showed nothing",
            device="shutter",
            hint="check the shutter's lag and its cable, and repeat the step",
        )


def check_camera_settings(
    seen: Mapping[str, RawSettings],
    *,
    iso: int,
    f_number: float | None = None,
    open_s: Mapping[str, float] | None = None,
) -> None:
    """Raise CalibrationError where files say that the camera was not set as asked.

    iso, f_number : as asked; None for a lens that is not set from here, which must then only be
        the same in all photos.
    open_s : for how long the shutter was to be open, by name.
    """
    for name, said in seen.items():
        if said.iso and said.iso != iso:
            raise CalibrationError(
                f"photo {name} was taken at ISO {said.iso}, not at ISO {iso}",
                device="camera",
                hint="switch the camera's automatic ISO off, or ask for the ISO that is set",
            )
        told = said.f_number
        if f_number is not None and told and not are_same_stop(told, f_number):
            raise CalibrationError(
                f"photo {name} was taken at f/{said.f_number:g}, not at f/{f_number:g}",
                device="camera",
                hint=f"set the lens to f/{f_number:g}, or ask for f/{said.f_number:g}",
            )
        asked_s = (open_s or {}).get(name, 0.0)
        if said.exposure_s and said.exposure_s + _BULB_S < asked_s:
            raise CalibrationError(
                f"photo {name} was exposed for {said.exposure_s:g} s, not for {asked_s:.3g} s",
                device="shutter",
                hint="set the camera to bulb; check the shutter's cable",
            )
    stops = {said.f_number for said in seen.values() if said.f_number}
    if len(stops) > 1:
        raise CalibrationError(
            f"the aperture changed within the series: f/{min(stops):g} to f/{max(stops):g}",
            device="camera",
            hint="set the camera to manual",
        )
    _check_black_level(seen)


def _check_black_level(seen: Mapping[str, RawSettings]) -> None:
    """Raise CalibrationError where the black level of a series moves."""
    blacks = [said.black_dn for said in seen.values() if said.black_dn]
    if not blacks:
        return
    spread = float(np.ptp(np.array(blacks), axis=0).max())
    if spread > BLACK_MOVES_DN:
        raise CalibrationError(
            f"the black level moves by {spread:.2g} DN within the series",
            device="camera",
            hint="let the camera warm up for ten minutes; switch long-exposure noise reduction off",
        )


def find_inliers(values: Iterable[float] | Floats) -> _Marks:
    """Which values are no outliers: within five robust deviations of the median."""
    values = np.asarray(values, dtype=np.float64)
    away = np.abs(values - np.median(values))
    spread = 1.4826 * float(np.median(away))
    return np.asarray(away <= 5.0 * spread + 1e-12 * (1.0 + np.abs(np.median(values))))
