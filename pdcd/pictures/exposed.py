"""A shot to make pictures of: its light, how sure that is, and the probing matrix it really had."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.probing.realised import Factors
from pdcd.sensor.bands import banded
from pdcd.sensor.profile import SensorProfile
from pdcd.sensor.raw import ALL, RawFrame, rgb_variance, to_rgb

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Errors = NDArray[np.floating]
"""Error bars: float64, or float32 where a frame is large."""

LARGE_QUADS = 2**18
"""Quads from which error bars are held in single precision."""


class Lit(Protocol):
    """Light of a frame and its variance, (h, w, 3) each."""

    @property
    def light(self) -> Floats:
        """Scene units times seconds."""
        ...

    @property
    def variance(self) -> Errors:
        """Of that."""
        ...


@dataclass(frozen=True)
class Ambient:
    """What gets in through an open mask before a black projector within a second, in scene units
    times seconds, and its variance: (h, w, 3) each."""

    light: Floats
    variance: Floats


class Exposed(Protocol):
    """A shot whose light can be had, whole or in pieces.

    light : (h, w, 3) float64
        Scene units times seconds, signed.
    variance : (h, w, 3) float64, or float32 where the frame is large
        Its variance by the sensor model.
    saturated : (h, w) bool
    realised : the probing matrix that the panels really gave it.
    exif : what its RAW file says of itself.
    missed : refreshes that came late or never, where that left codes with unequal light.
    """

    @property
    def light(self) -> Floats:
        """See above."""
        ...

    @property
    def variance(self) -> Errors:
        """See above."""
        ...

    @property
    def saturated(self) -> Bools:
        """See above."""
        ...

    @property
    def realised(self) -> Factors:
        """See above."""
        ...

    @property
    def exif(self) -> dict[str, object]:
        """See above."""
        ...

    @property
    def missed(self) -> int:
        """See above."""
        ...

    def light_at(self, rows: slice, columns: slice = ALL) -> Floats:
        """Light of some rows and columns of quads."""
        ...

    def variance_at(self, rows: slice, columns: slice = ALL) -> Errors:
        """Its variance."""
        ...


@dataclass(frozen=True)
class Print:
    """A shot whose light is worked out, as a sum of others or one that was foreseen; `Exposed`."""

    light: Floats
    variance: Errors
    saturated: Bools
    realised: Factors
    exif: dict[str, object]
    missed: int = 0

    def light_at(self, rows: slice, columns: slice = ALL) -> Floats:
        """Light of some rows and columns of quads."""
        return self.light[rows, columns]

    def variance_at(self, rows: slice, columns: slice = ALL) -> Errors:
        """Its variance."""
        return self.variance[rows, columns]


@dataclass(frozen=True)
class Negative:
    """A shot as its RAW file has it; light and variance are worked out when they are asked for.

    A camera's frame of light with its variance takes four times as much memory as its samples, and
    a run has dozens; what is worked out piece by piece stays in the cache.

    raw : the samples. profile : of the sensor. exposure_s : as timed by the bench. factors : (3,),
    from DN to scene units times seconds. The rest as of `Exposed`.
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
        return banded((*self.raw.frame, 3), np.float64, self.light_at)

    @property
    def variance(self) -> Errors:
        """All of it, made anew every time."""
        return banded((*self.raw.frame, 3), self._precision, self.variance_at)

    @property
    def saturated(self) -> Bools:
        """(h, w)"""
        return self.raw.saturated

    @property
    def exif(self) -> dict[str, object]:
        """What the RAW file says of itself."""
        return self.raw.exif()

    def light_at(self, rows: slice, columns: slice = ALL) -> Floats:
        """Light of some rows and columns of quads."""
        return to_rgb(self.raw.signal(rows, columns), self.factors)

    def variance_at(self, rows: slice, columns: slice = ALL) -> Errors:
        """Its variance by the sensor model."""
        signal, factors = self.raw.signal(rows, columns), self.factors / self.raw.side
        return rgb_variance(
            signal, self.profile, self.iso, self.exposure_s, factors, self._precision
        )

    @property
    def _precision(self) -> type[np.floating]:
        return np.float32 if self.saturated.size >= LARGE_QUADS else np.float64


def refuse_unlike(name: str, raw: RawFrame, frame: tuple[int, int], like: tuple[str, int]) -> None:
    """Raise DecodeError for a RAW file that is not like the first one of its run: of so many rows
    and columns of quads, and of that model and orientation."""
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
