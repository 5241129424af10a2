"""A shot to make pictures of: its light, the variance of that, and its realised probing matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.errors import DecodeError
from pdcd.probing.realised import Factors
from pdcd.sensor.bands import fill_in_bands
from pdcd.sensor.colours import compute_colour_variance, to_colours
from pdcd.sensor.profile import SensorProfile
from pdcd.sensor.raw import WHOLE_AXIS, RawFrame

_Errors = NDArray[np.floating]
"""Error bars: float64, or float32 where a frame is large."""

_LARGE_QUADS = 2**18
"""Quads from which error bars are held in single precision."""


@dataclass(frozen=True)
class AmbientLight:
    """What gets in through an open mask in front of a black projector within a second, in scene
    units times seconds, and its variance: (h, w, C) each."""

    light: Floats
    variance: Floats


@dataclass(frozen=True)
class ComputedShot:
    """A shot whose light is computed, as a sum or as a forecast.

    light : (h, w, C) float64
        Scene units times seconds, signed.
    variance : (h, w, C) float64, or float32 where the frame is large
        Its variance by the sensor model.
    saturated : (h, w) bool
    realised : the probing matrix that the panels really gave it.
    exif : what its RAW file says about itself.
    missed : refreshes that came late or never, where that left codes with unequal light.
    """

    light: Floats
    variance: _Errors
    saturated: Bools
    realised: Factors
    exif: dict[str, object]
    missed: int = 0

    def light_at(self, rows: slice, columns: slice = WHOLE_AXIS) -> Floats:
        """Light of some rows and columns of quads."""
        return self.light[rows, columns]

    def variance_at(self, rows: slice, columns: slice = WHOLE_AXIS) -> _Errors:
        """Its variance."""
        return self.variance[rows, columns]


@dataclass(frozen=True)
class RawShot:
    """A shot as its RAW file has it; light and variance are worked out when they are asked for.

    A camera's frame of light with its variance takes four times as much memory as its samples, and
    a run has dozens; what is computed piece by piece stays in the processor's cache.

    raw : the samples. profile : of the sensor. exposure_s : as timed by the bench. factors : (C,),
    from DN to scene units times seconds. The rest as of `ComputedShot`.
    """

    raw: RawFrame
    profile: SensorProfile
    iso: int
    exposure_s: float
    factors: Floats
    realised: Factors
    missed: int = 0

    @property
    def light(self) -> Floats:
        """All of it, made anew every time."""
        return fill_in_bands((*self.raw.frame, self.raw.colours), np.float64, self.light_at)

    @property
    def variance(self) -> _Errors:
        """All of it, made anew every time."""
        shape = *self.raw.frame, self.raw.colours
        return fill_in_bands(shape, self._precision, self.variance_at)

    @property
    def saturated(self) -> Bools:
        """(h, w)"""
        return self.raw.saturated

    @property
    def exif(self) -> dict[str, object]:
        """What the RAW file says about itself."""
        return self.raw.exif()

    def light_at(self, rows: slice, columns: slice = WHOLE_AXIS) -> Floats:
        """Light of some rows and columns of quads."""
        return to_colours(self.raw.signal(rows, columns), self.factors)

    def variance_at(self, rows: slice, columns: slice = WHOLE_AXIS) -> _Errors:
        """Its variance by the sensor model."""
        signal, factors = self.raw.signal(rows, columns), self.factors / self.raw.side
        return compute_colour_variance(
            signal, self.profile, self.iso, self.exposure_s, factors, self._precision
        )

    @property
    def _precision(self) -> type[np.floating]:
        return np.float32 if self.saturated.size >= _LARGE_QUADS else np.float64


ExposedShot = ComputedShot | RawShot
"""A shot to make pictures of, whose light can be had whole or in pieces."""
FrameLight = AmbientLight | ExposedShot
"""Light of a frame of C colours and its variance, (h, w, C) each."""


def refuse_unlike(
    name: str, raw: RawFrame, frame: tuple[int, int], colours: int, like: tuple[str, int]
) -> None:
    """Raise DecodeError for a RAW file unlike the first one of its run, which had `frame` quads
    (rows, columns), so many `colours`, and the model and orientation `like`."""
    if raw.colours != colours:
        raise DecodeError(
            f"{name} has {raw.colours} colours, the camera of the run has {colours}",
            hint="restore it from a copy",
        )
    if raw.frame != frame:
        raise DecodeError(
            f"{name} has {raw.frame[0]} x {raw.frame[1]} pixels, other shots of the run "
            f"{frame[0]} x {frame[1]}",
            hint="restore it from a copy",
        )
    if (raw.model, raw.flip) != like:
        raise DecodeError(
            f"{name} is of {raw.model or 'no camera'} with orientation {raw.flip}, other "
            f"shots of the run of {like[0] or 'no camera'} with {like[1]}",
            hint="take all shots with one camera that stays as it is; switch its automatic "
            "rotation off",
        )
