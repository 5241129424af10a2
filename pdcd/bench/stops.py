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

_NEAR = 0.03
"""A number so close to 2^(k/6) stands for it: engraved ones are at most 2.4 % off. Half stops and
what is typed freely lie further away, and stay what they are."""
STOP_SIGMA = 0.04
"""Standard deviation of the light of a stop that nobody measured, relative: f-numbers are true to
2 %, and light goes with their square."""


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
