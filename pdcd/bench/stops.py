"""The light of a lens's stops; no other module computes it.

A lens is engraved with round numbers that stand for 2^(k/6), a third of a stop apart: f/13 for
12.70, f/11 for 11.31. A real lens keeps to that only within some per cent. So the light of two
stops can be compared exactly only where it was measured, by a calibration or in the run itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated

import msgspec

from pdcd.errors import ExposureError

_NEAR = 0.03
"""Relative distance from 2^(k/6) within which a number stands for it: engraved ones are off by 2.4
% at most. Half stops and freely typed numbers lie further away, and stay as they are."""
STOP_SIGMA = 0.04
"""Standard deviation of the light of a stop that was not measured, relative: f-numbers are true to
2 %, and light goes with their square."""


_SAME = 0.06
"""Relative difference up to which two f-numbers may be of the same stop."""


class Stop(msgspec.Struct, frozen=True):
    """A stop of a lens.

    f_number : as engraved, or as it is set. true : the f-number by its light, which goes with
    1 / true^2. sigma : standard deviation of that light, relative.
    """

    f_number: Annotated[float, msgspec.Meta(gt=0.0)]
    true: Annotated[float, msgspec.Meta(gt=0.0)]
    sigma: Annotated[float, msgspec.Meta(ge=0.0)] = STOP_SIGMA


def stop_of(f_number: float, known: Iterable[Stop] = ()) -> Stop:
    """The stop with that engraved number: the measured one if it is among `known`, else 2^(k/6)
    with its uncertainty. To be used wherever light is divided by the aperture."""
    for stop in known:
        if math.isclose(stop.f_number, f_number, rel_tol=1e-3):
            return stop
    third = 2.0 ** (round(6.0 * math.log2(f_number)) / 6.0)
    near = abs(third / f_number - 1.0) <= _NEAR
    return Stop(f_number, third if near else f_number)


def compute_light_sigma(one: Stop, other: Stop) -> float:
    """Relative standard deviation of the ratio of two stops' light."""
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
    """Raise ExposureError for a photo whose file says another ISO or stop than was asked for: light
    and noise would be computed from the wrong one.

    said : ISO and f-number; 0 and None for a file that says nothing.
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
