"""What a step of a calibration says: figures with their errors, limits and verdicts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

ROOM_GOOD, ROOM_MOST = 0.075, 0.2
"""Light of the room over the projector's white: up to the first, every step subtracts it; beyond
the second, no step is tried."""


def describe_room_light(share: float) -> str:
    """What to say where the light of the room is this share of the projector's white."""
    return f"room light is {100.0 * share:.2g} % of white: darken the room"


class Verdict(IntEnum):
    """What a figure means for the bench."""

    GOOD = 0
    DOUBTFUL = 1
    BAD = 2


@dataclass(frozen=True)
class MeasuredFigure:
    """One measured number.

    name : in the configuration's own words where it has one: "mask.skew_s".
    value, sigma : in `unit`; sigma is one standard deviation.
    limit : what is accepted, in words and numbers; "" where anything is.
    """

    name: str
    value: float
    sigma: float
    unit: str
    limit: str = ""
    verdict: Verdict = Verdict.GOOD
