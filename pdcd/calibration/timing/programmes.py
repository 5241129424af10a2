"""What both panels show so that one photo contains all their times: pulses side by side.

A *programme* makes both panels pulse in a rhythm of a few refreshes, each in its own. The card is
divided into vertical strips, each with a programme of its own; some of them stay white, black, lit
or open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.shown import PanelSequence
from pdcd.calibration.window import WHOLE, Window
from pdcd.errors import CalibrationError
from pdcd.panels.frames import BLACK
from pdcd.panels.map import Map

_PERIODS = 30
"""Periods of pulses in one photo: 3 s at 60 Hz."""
_INSET_PX = 8.0
"""Projector pixels by which a strip of the mask ends before that of the projector, either side."""
_FEWEST_PX = 5
"""Columns of pixels that a strip must have on either panel."""


@dataclass(frozen=True)
class Programme:
    """What both panels are asked for, over and over.

    lit, opened : of projector and mask, a "1" for each refresh of white and a "0" for each of
        black, equally many.
    """

    lit: str
    opened: str

    @property
    def of(self) -> int:
        """Refreshes after which it repeats."""
        return len(self.lit)

    @property
    def on(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether projector and mask are white, (of,) bool each."""
        lit, opened = (np.array([c == "1" for c in side]) for side in (self.lit, self.opened))
        return lit, opened

    @property
    def still(self) -> bool:
        """Whether neither panel pulses."""
        return len(set(self.lit)) == len(set(self.opened)) == 1


def _pulse(lit: int, opened: int, delay: int = 0, of: int = 6) -> Programme:
    """One pulse of either panel, `lit` and `opened` refreshes long.

    delay : refreshes by which the mask's pulse begins later than the projector's; negative:
        earlier.
    """
    at = np.arange(of) - of // 2
    sides = (at % of < lit, (at - delay) % of < opened)
    return Programme(*("".join("01"[int(on)] for on in side) for side in sides))


WHITES = _pulse(6, 6)
BLACKS = _pulse(0, 0)
_LIT = _pulse(6, 0)
_OPENED = _pulse(0, 6)
PULSES = {
    _pulse(lit, opened, delay): ((lit, opened), delay)
    for lit, opened in ((1, 1), (2, 1), (1, 2))
    for delay in range(-3, 3)
}
"""Short pulses, by the refreshes for which projector and mask are white and by the mask's delay:
the mask's pulse meets the projector's at any delay of up to three refreshes."""
_TRAINS = tuple(
    Programme(lit, opened)
    for lit, masks in (
        ("100100", (*4 * ("001001",), *4 * ("010010",), "011011", "101101")),
        ("101010", 2 * ("101010",)),
        ("110110", ("010010",)),
        ("111000", 3 * ("001100",)),
        ("111100", ("001100",)),
        ("111010", ("100010",)),
    )
    for opened in masks
)
"""Trains of pulses, between which panels hardly settle. They were chosen one by one from all trains
of six refreshes, so that photon noise leaves the least uncertainty of rise, fall and lag of 40
random benches once `PULSES` were shown: two thirds of what as many `PULSES` again would leave. The
most useful ones come several times, at several places of the card. For a panel that is not quite
exponential, pulses followed by a long dark time say more."""
_REFERENCES = (WHITES, BLACKS, WHITES, BLACKS, _LIT, _OPENED)
SETS = ((*PULSES, *_REFERENCES), (*_TRAINS, *_REFERENCES))
"""What the strips show in alternating photos."""
COARSE = {_pulse(2, 2, delay, 24): delay for delay in range(-12, 12)}
"""For a mask that may be many refreshes late, by the mask's delay: light gets through where that
delay compensates it."""


def expand_programmes(
    programmes: Sequence[Programme],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether projector and mask are asked for white, (K, refreshes), by programmes of equal
    length."""
    lit, opened = (np.stack([p.on[side] for p in programmes]) for side in (0, 1))
    return lit, opened


@dataclass(frozen=True)
class PulseStrips:
    """Vertical strips of the field, equally wide, each with a programme, from left to right.

    inset : how far a strip of the mask ends inside that of the projector, on either side, over the
        strip's width.
    window : the part of the field that they fill.
    """

    programmes: tuple[Programme, ...]
    inset: float
    window: Window = WHOLE

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.programmes)

    def number(self, x: Floats, inset: float = 0.0) -> NDArray[np.int32]:
        """The strip in which each x of the field lies; -1 outside of them, in the `inset` of a
        strip, and for NaN."""
        with np.errstate(invalid="ignore"):
            place = self.window.across(x) * self.count
            part = place - np.floor(place)
            inside = (place >= 0.0) & (place < self.count) & (part >= inset) & (part < 1.0 - inset)
        return np.where(inside, np.where(inside, place, 0.0), -1).astype(np.int32)


def make_pulse_strips(
    projector: Map,
    photo: int = 0,
    programmes: tuple[Programme, ...] | None = None,
    window: Window = WHOLE,
) -> PulseStrips:
    """Strips of one photo; every photo has the programmes in another order.

    programmes : None takes those of `SETS` in turn. window : the part of the field to fill.

    Raises CalibrationError when the projector has too few pixels for them.
    """
    programmes = programmes or SETS[photo % len(SETS)]
    count = len(programmes)
    width_px = projector.size_px[0] * (window.right - window.left) / count
    if width_px < _FEWEST_PX:
        raise CalibrationError(
            f"strips would be {width_px:.1f} px wide on the projector",
            device="projector",
            hint=f"they need {_FEWEST_PX} px or more: show the programmes one by one",
        )
    order = np.random.default_rng(photo).permutation(count)
    return PulseStrips(tuple(programmes[k] for k in order), min(_INSET_PX / width_px, 0.2), window)


def make_strip_sequence(
    name: str,
    strips: PulseStrips,
    projector: Map,
    mask: Map,
    *,
    white: bool,
    periods: int = _PERIODS,
) -> PanelSequence:
    """One photo of the strips, or with `white` the one by which it is divided.

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
    return PanelSequence(name, found[0], found[1], index, index.copy())


def make_room_sequence(white: PanelSequence) -> PanelSequence:
    """The white photo with a black projector: it shows light on the mask other than the projector's
    white."""
    return replace(white, name="room", projector_index=np.full_like(white.projector_index, BLACK))
