"""What both panels show so that one photo holds all their times: pulses side by side.

A *programme* lets both panels pulse once every few refreshes, the mask some refreshes off. The card
is divided into vertical strips, each with a programme of its own, and some that stay white, black,
lit or open. On a scene without a card each programme is shown on the whole field, a photo each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.pulses import Pulse
from pdcd.calibration.shown import Bits, Shown
from pdcd.errors import CalibrationError
from pdcd.frames.frames import BLACK, WHITE
from pdcd.maps.map import Map

Floats = NDArray[np.float64]

PERIODS = 30
"""Periods of pulses in one photo: 3 s at 60 Hz."""
INSET_PX = 8.0
"""Projector pixels by which a strip of the mask ends before that of the projector, either side."""
FEWEST_PX = 5
"""Columns of pixels that a strip must have on either panel."""


@dataclass(frozen=True)
class Programme:
    """What both panels are asked for, again and again every `of` refreshes.

    lit, opened : refreshes for which projector and mask are white. delay : refreshes by which the
        mask's pulse begins later than the projector's; negative: earlier.
    """

    lit: int
    opened: int
    delay: int = 0
    of: int = 6

    @property
    def on(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether projector and mask are white, (of,) bool each."""
        middle, at = self.of // 2, np.arange(self.of)
        return (at - middle) % self.of < self.lit, (
            at - middle - self.delay
        ) % self.of < self.opened

    @property
    def still(self) -> bool:
        """Whether neither panel pulses."""
        return {self.lit, self.opened} <= {0, self.of}


WHITES = Programme(6, 6)
BLACKS = Programme(0, 0)
LIT = Programme(6, 0)
OPENED = Programme(0, 6)
PULSES = tuple(
    Programme(lit, opened, delay)
    for lit, opened in ((1, 1), (2, 1), (1, 2))
    for delay in range(-3, 3)
)
"""The 18 programmes that tell rise, fall and lag of both panels apart."""
ALL = (*PULSES, WHITES, BLACKS, WHITES, BLACKS, LIT, OPENED)
"""What the strips show, references included."""
COARSE = tuple(Programme(2, 2, delay, 24) for delay in range(-12, 12))
"""For a mask that may be many refreshes late: where light gets through, the delay is made good."""


def pulses(programmes: Sequence[Programme], refresh_s: float) -> tuple[Pulse, Pulse]:
    """What projector and mask are asked for, arrays (K,) of programmes of equal length."""
    period = programmes[0].of
    lit, opened, late = (
        np.array([getattr(p, name) for p in programmes], dtype=np.float64) * refresh_s
        for name in ("lit", "opened", "delay")
    )
    return (
        Pulse(np.zeros(len(programmes)), lit, period * refresh_s),
        Pulse(late, opened, period * refresh_s),
    )


@dataclass(frozen=True)
class Strips:
    """Vertical strips of the field, equally wide, with a programme each, from left to right.

    inset : by how much of a strip's width the mask's ends before the projector's, either side.
    """

    programmes: tuple[Programme, ...]
    inset: float

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.programmes)

    def number(self, x: Floats, inset: float = 0.0) -> NDArray[np.int32]:
        """Strip that each x of the field lies in; -1 beside the field, in the `inset` of a strip,
        and for NaN."""
        with np.errstate(invalid="ignore"):
            place = x * self.count
            part = place - np.floor(place)
            inside = (x >= 0.0) & (x < 1.0) & (part >= inset) & (part < 1.0 - inset)
        return np.where(inside, np.where(inside, place, 0.0), -1).astype(np.int32)


def strips_on(projector: Map, photo: int = 0, programmes: tuple[Programme, ...] = ALL) -> Strips:
    """Strips of one photo; every photo has the programmes in another order.

    Raises CalibrationError when the projector has too few pixels for them.
    """
    count = len(programmes)
    width_px = projector.size_px[0] / count
    if width_px < FEWEST_PX:
        raise CalibrationError(
            f"strips would be {width_px:.1f} px wide on the projector",
            device="projector",
            hint=f"they need {FEWEST_PX} px or more: show the programmes one by one",
        )
    order = np.random.default_rng(photo).permutation(count)
    return Strips(tuple(programmes[k] for k in order), min(INSET_PX / width_px, 0.2))


def strip_photo(
    name: str,
    strips: Strips,
    projector: Map,
    mask: Map,
    *,
    white: bool,
    periods: int = PERIODS,
) -> Shown:
    """One photo of the strips, or with `white` the one that it is divided by.

    projector, mask : where the panels' pixels lie. Both photos last equally long.
    """
    period = strips.programmes[0].of
    found = []
    for map_, inset, side in ((projector, 0.0, 0), (mask, strips.inset, 1)):
        centres = map_.centres()
        inside = (centres[..., 1] >= 0.0) & (centres[..., 1] < 1.0)
        strip = np.where(inside, strips.number(centres[..., 0], inset), -1)
        on = np.stack([p.on[side] | white for p in strips.programmes])  # (K, period)
        on = np.vstack([on, np.zeros(period, dtype=np.bool_)])  # what lies beside, at -1
        found.append(np.stack([on[:, at][strip] for at in range(1 if white else period)]))
    index = np.tile(np.arange(period), periods).astype(np.int32)
    index = index * (not white)
    return Shown(name, found[0], found[1], index, index.copy())


def whole_photos(programmes: Sequence[Programme] = ALL, *, every: int = 6) -> list[Shown]:
    """The programmes on the whole field, a photo each, and white before each `every` and after all.

    White photos are named ``white-0``, ``white-1``, ..., the others ``pulse-K`` by the programme.
    """
    none: Bits = np.zeros((0, 0, 0), dtype=np.bool_)

    def photo(name: str, programme: Programme) -> Shown:
        rows = [
            np.tile(np.where(side, WHITE, BLACK).astype(np.int32), PERIODS) for side in programme.on
        ]
        return Shown(name, none, none, rows[0], rows[1])

    period = programmes[0].of
    white = Programme(period, period, 0, period)
    photos, whites = [], 0
    for number, programme in enumerate(programmes):
        if number % every == 0:
            photos.append(photo(f"white-{whites}", white))
            whites += 1
        photos.append(photo(f"pulse-{number}", programme))
    return [*photos, photo(f"white-{whites}", white)]
