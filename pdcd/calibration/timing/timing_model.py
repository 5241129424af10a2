"""What strips of pulses should look like, as a function of the times of both panels.

A strip of a band gives ``scale * [mean of (x_p + a)(x_m + b)] / [(1 + a)(1 + b)] + stray``, with
x_p and x_m the responses of the panels, a the light on the mask other than the projector's white
(its leak, and ambient light), b the mask's leak, and stray the light that bypasses the mask. Each
band of each photo has its own scale and stray light; each band has its lag; the other times and the
leaks are those of the whole bench. The projector is darker in its corners, and the room's light is
not: what a photo of the room showed at each place (`StripReadings.room`) is part of a. Light that
bypassed the mask in that photo is not. Stray light is distributed over the field as the room's is
(`StripReadings.past`), with one number for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.timing.programmes import expand_programmes
from pdcd.calibration.timing.strips import StripReadings
from pdcd.panels.frames import BLACK, FrameLog
from pdcd.probing.pulses import PanelResponse, compute_pulse_light, compute_pulse_product

_NODES = np.array([-0.5, 0.0, 0.5]) * np.sqrt(0.6)
"""Places in a band at which its lag is evaluated, in bands from the middle (Gauss, 3 points)."""
_NODE_SHARES = np.array([5.0, 8.0, 5.0]) / 18.0
_AFTER = 24
"""Black refreshes after an exposure, at whose end a late or slow mask is black."""
STEP = 1e-5
"""Step of the numeric derivatives: of the logarithm of a time constant, or in refreshes."""

TAUS = ("projector.rise_s", "projector.fall_s", "mask.rise_s", "mask.fall_s")
COMMON_PARAMETERS = 6
"""Parameters before the lags: four logarithms of time constants, two leaks."""


@dataclass(frozen=True)
class Tail:
    """Which panel has a second, slower response; its share, and by what factor it is slower."""

    mask: bool
    share: float
    slower: float


@dataclass(frozen=True, eq=False)
class PanelTimes:
    """The times and leaks to be found.

    taus_s : (4,) as `TAUS`. leaks : (2,) a on average, less `StripReadings.room`, and b.
    lags_s : (B,) of the mask's light behind the projector's, in addition to what the frame log
        explains, in the middle of its rows.
    across_s : growth of the lag from x = 0 to x = 1, for panels that are turned against the field
        and set row by row.
    """

    taus_s: Floats
    leaks: Floats
    lags_s: Floats
    tail: Tail | None = None
    across_s: float = 0.0

    @property
    def answers(self) -> tuple[PanelResponse, PanelResponse]:
        """Responses of projector and mask."""
        more = [(0.0, 1.0), (0.0, 1.0)]
        if self.tail is not None:
            more[int(self.tail.mask)] = (self.tail.share, self.tail.slower)
        rise_p, fall_p, rise_m, fall_m = (float(tau) for tau in self.taus_s)
        return PanelResponse(rise_p, fall_p, *more[0]), PanelResponse(rise_m, fall_m, *more[1])


@dataclass(frozen=True, eq=False)
class PhotoLog:
    """What the display and the shutter did in one photo; times on the clock of the log."""

    log: FrameLog
    open_ns: int
    close_ns: int

    @property
    def apart_s(self) -> float:
        """How much later than the projector the mask was sent the same row, on average."""
        stamps = [
            dict(zip(shown.tolist(), at.tolist(), strict=True))
            for shown, at in (
                (self.log.primal_shown, self.log.primal_ns),
                (self.log.dual_shown, self.log.dual_ns),
            )
        ]
        both = sorted((stamps[0].keys() & stamps[1].keys()) - {-1})
        return float(np.mean([stamps[1][row] - stamps[0][row] for row in both])) * 1e-9

    @property
    def slots_apart_s(self) -> float:
        """How much later than the projector's refreshes the mask's began that the log lists with
        them, on average."""
        return float(np.mean(self.log.dual_ns - self.log.primal_ns)) * 1e-9

    def shown(self, refresh_s: float) -> NDArray[np.int32]:
        """The row that projector and mask showed in each refresh, (2, n), `BLACK` ones at the end;
        a row that was held for several refreshes is repeated."""
        log, both = self.log, []
        for rows, at, end in (
            (log.primal_shown, log.primal_ns, log.end_ns[0]),
            (log.dual_shown, log.dual_ns, log.end_ns[1]),
        ):
            number = np.rint((np.append(at, end) - at[0]) * 1e-9 / refresh_s).astype(np.int64)
            both.append(np.repeat(rows, np.diff(number)))
        longest = max(rows.size for rows in both) + _AFTER
        ends = [(0, longest - rows.size) for rows in both]
        return np.stack(
            [np.pad(r, end, constant_values=BLACK) for r, end in zip(both, ends, strict=True)]
        )


class StripModel:
    """The readings of all photos of one set of bands.

    readings : each (B, K), of equal bands. ran : what was shown in each. refresh_s : of both
        panels.
    """

    def __init__(
        self, readings: Sequence[StripReadings], ran: Sequence[PhotoLog], refresh_s: float
    ) -> None:
        self.readings, self.ran, self.refresh_s = readings, ran, refresh_s
        self.slope_s = 0.0
        self.correction = np.zeros((len(readings), 1, 1))
        self._asked = [expand_programmes(r.programmes) for r in readings]
        self._apart_s = [r.apart_s for r in ran]

    @property
    def height(self) -> float:
        """Height of a band on the field."""
        return self.readings[0].height

    @property
    def apart_s(self) -> float:
        """See `PhotoLog.apart_s`, mean of all photos."""
        return float(np.mean(self._apart_s))

    def shape(self, times: PanelTimes) -> Floats:
        """Light over white of every reading, (photos, B, K): that of endless pulses, plus the
        correction by `correct`."""
        return np.asarray(self.shapes([times])[0])

    def shapes(self, variants: Sequence[PanelTimes]) -> Floats:
        """The same for several, (variants, photos, B, K), all with or all without a tail."""
        both = [(r.room, r.past) for r in self.readings]
        return self._shapes(variants, both, self._asked, self._apart_s) + self.correction

    def anywhere(self, times: PanelTimes) -> Floats:
        """Light of strips of no particular band at each of many lags, (photos, lags, K)."""
        both = [(r.room, r.past) for r in self.readings]
        mean = [tuple(of_bands.mean(axis=0, keepdims=True) for of_bands in pair) for pair in both]
        return np.asarray(self._shapes([times], mean, self._asked, self._apart_s)[0])

    def correct(self, times: PanelTimes) -> None:
        """Set `correction`: the effect of the beginning and end of the exposures at these times. It
        is the light of all refreshes of the log, black ones after them, over white that is as long,
        minus the light of endless pulses."""
        both = [(r.room, r.past) for r in self.readings]
        shown = [ran.shown(self.refresh_s) for ran in self.ran]
        apart = [ran.slots_apart_s for ran in self.ran]
        strips, white = [], []
        for (lit, opened), rows in zip(self._asked, shown, strict=True):
            on = rows != BLACK
            strips.append(
                tuple(
                    side[:, row % side.shape[1]] & at
                    for side, row, at in zip((lit, opened), rows, on, strict=True)
                )
            )
            white.append((on[:1], on[1:]))
        # The correction hardly changes within a band: the middle is enough.
        slope, self.slope_s = self.slope_s, 0.0
        plain = self._shapes([times], both, self._asked, self._apart_s)
        whole, full = (self._shapes([times], both, pairs, apart) for pairs in (strips, white))
        self.slope_s, self.correction = slope, (whole / full - plain)[0]

    def _shapes(
        self,
        variants: Sequence[PanelTimes],
        rooms: Sequence[tuple[Floats, ...]],
        pairs: Sequence[tuple[NDArray[np.bool_], ...]],
        apart_s: Sequence[float],
    ) -> Floats:
        nodes = _NODES * self.slope_s * self.height if self.slope_s else np.zeros(1)
        shares = _NODE_SHARES if self.slope_s else np.ones(1)
        lags = np.stack([times.lags_s for times in variants])  # (V, B)
        late = lags[..., None, None] + nodes[:, None]  # (V, B, nodes, 1)
        across = np.array([times.across_s for times in variants])[:, None, None, None]
        answers, leaks = _stacked(variants)
        parts = []
        for reading, pair, apart, room in zip(self.readings, pairs, apart_s, rooms, strict=True):
            late_s = late + across * reading.x + apart
            if self.slope_s:
                late_s = late_s + self.slope_s * reading.off[:, None]
            on_mask, past = (of_bands[:, None] for of_bands in room)
            beside = leaks[0] * past + on_mask, leaks[1]
            found = _over_white(answers, beside, pair, late_s, self.refresh_s)
            parts.append(np.tensordot(found, shares, (2, 0)))
        return np.stack(parts, axis=1)


def _stacked(
    variants: Sequence[PanelTimes],
) -> tuple[tuple[PanelResponse, PanelResponse], tuple[Floats, Floats]]:
    """Responses and leaks of both panels, arrays (V, 1, 1, 1)."""
    answers = [times.answers for times in variants]

    def column(values: list[float | Floats]) -> Floats:
        return np.array(values, dtype=np.float64)[:, None, None, None]

    projector, mask = (
        PanelResponse(
            column([pair[side].rise_s for pair in answers]),
            column([pair[side].fall_s for pair in answers]),
            column([pair[side].tail for pair in answers]),
            column([pair[side].slower for pair in answers]),
        )
        for side in (0, 1)
    )
    a, b = (column([times.leaks[side] for times in variants]) for side in (0, 1))
    return (projector, mask), (a, b)


def _over_white(
    answers: tuple[PanelResponse, PanelResponse],
    leaks: tuple[Floats, Floats],
    pair: tuple[NDArray[np.bool_], ...],
    late_s: Floats,
    refresh_s: float,
) -> Floats:
    """Light of strips over that of white, leaks included."""
    (projector, mask), (a, b), (lit, opened) = answers, leaks, pair
    product = compute_pulse_product(projector, mask, lit, opened, late_s, refresh_s)
    alone = a * compute_pulse_light(mask, opened, refresh_s) + b * compute_pulse_light(
        projector, lit, refresh_s
    )
    alone = alone + a * b
    return np.asarray((product + alone) / ((1.0 + a) * (1.0 + b)))
