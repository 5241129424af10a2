"""How much light the stops of a lens let through: the one place that knows.

A lens is engraved with round numbers that stand for 2^(k/6), a third of a stop apart: f/13 for
12.70, f/11 for 11.31. Each lens is true to that within some per cent only. So the light of two
stops is compared exactly only where it was measured, by a calibration or in the run itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated

import msgspec

from pdcd.errors import ExposureError

_NEAR = 0.03
"""A number so close to 2^(k/6) stands for it: engraved ones are at most 2.4 % off. Half stops and
what is typed freely lie further away, and stay what they are."""
STOP_SIGMA = 0.04
"""Standard deviation of the light of a stop that nobody measured, relative: f-numbers are true to
2 %, and light goes with their square."""


_SAME = 0.06
"""Share by which two f-numbers may differ and be of the same stop."""


class Stop(msgspec.Struct, frozen=True):
    """A stop of a lens.

    f_number : as engraved, or as it is set. true : the f-number by its light, which goes with
    1 / true^2. sigma : standard deviation of that light, relative.
    """

    f_number: Annotated[float, msgspec.Meta(gt=0.0)]
    true: Annotated[float, msgspec.Meta(gt=0.0)]
    sigma: Annotated[float, msgspec.Meta(ge=0.0)] = STOP_SIGMA


def stop_of(f_number: float, known: Iterable[Stop] = ()) -> Stop:
    """The stop that is engraved so: one of those that are `known`, else 2^(k/6) and how sure that
    is. Who divides light by the aperture asks."""
    for stop in known:
        if math.isclose(stop.f_number, f_number, rel_tol=1e-3):
            return stop
    third = 2.0 ** (round(6.0 * math.log2(f_number)) / 6.0)
    near = abs(third / f_number - 1.0) <= _NEAR
    return Stop(f_number, third if near else f_number)


def compute_light_sigma(one: Stop, other: Stop) -> float:
    """Relative standard deviation of the light of one stop over that of another."""
    return 0.0 if one.f_number == other.f_number else math.hypot(one.sigma, other.sigma)


class AbsoluteScale(msgspec.Struct, frozen=True):
    """What the absolute scale of all pictures of a run goes by.

    source : in words. sigma : its standard deviation, relative, common to all pixels and colours;
    None where nobody knows. No error bar of a picture holds it.
    """

    source: str
    sigma: Annotated[float, msgspec.Meta(ge=0.0)] | None = None


def are_same_stop(one: float, other: float) -> bool:
    """Whether two f-numbers may be what a file and a person call the same stop."""
    return abs(one / other - 1.0) <= _SAME


def refuse_other_settings(
    file: str, said: tuple[int, float | None], iso: int, f_number: float
) -> None:
    """Raise ExposureError for a photo that was taken at another ISO or stop than was asked for, by
    what its file says: light and noise would be computed by the wrong one.

    said : ISO and f-number; 0 and None of a file that says nothing.
    """
    if said[0] and said[0] != iso:
        raise ExposureError(
            f"{file} was taken at ISO {said[0]}, not at ISO {iso}",
            device="camera",
            hint="switch the camera's automatic ISO off, or ask for the ISO that is set",
        )
    if said[1] and not are_same_stop(said[1], f_number):
        raise ExposureError(
            f"{file} was taken at f/{said[1]:g}, not at f/{f_number:g}",
            device="camera",
            hint="set the camera to manual, and the lens as camera.f_number says",
        )
