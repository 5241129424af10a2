"""Two panels that pulse in step: how much light gets through both, in closed form.

A panel that is asked for white during ``A`` of every period ``P`` rises by ``r`` and falls by
``f``. With ``E_r = exp(-A/r)`` and ``E_f = exp(-(P-A)/f)`` it starts a pulse at
``x0 = E_f (1-E_r)/(1 - E_r E_f)``, ends it at ``x1 = (1-E_r)/(1 - E_r E_f)``, and is in between
``1 - (1-x0) exp(-t/r)``, after it ``x1 exp(-t/f)``. The product of two such panels falls into at
most four stretches a period, each an integral of two exponentials.

`pdcd.probing.realised` says the same of any exposure; this is it for pulses without beginning or
end, some thousand times faster, as a fit needs it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdcd.frames.schedule import SLOTS
from pdcd.words import ScheduleName

Floats = NDArray[np.float64]

SHORTEST_S = 1e-7
"""Time constants below this one are taken as it: nothing that a camera sees tells them apart."""
CODES = 12
"""Codes in a cycle, to foretell what of one gets into the others: the far ones get nothing."""


@dataclass(frozen=True)
class Answer:
    """How a panel answers, in s: first order, or two such answers at once.

    tail, slower : the share `tail` of the light rises and falls `slower` times as slowly.

    Arrays of answers, too, where they fit what they are asked for.
    """

    rise_s: float | Floats
    fall_s: float | Floats
    tail: float | Floats = 0.0
    slower: float | Floats = 1.0

    @property
    def parts(self) -> list[tuple[float | Floats, float | Floats, float | Floats]]:
        """Share, rise and fall of each first-order answer that it is the sum of."""
        if not np.any(self.tail):
            return [(1.0, self.rise_s, self.fall_s)]
        return [
            (1.0 - self.tail, self.rise_s, self.fall_s),
            (self.tail, self.rise_s * self.slower, self.fall_s * self.slower),
        ]


@dataclass(frozen=True)
class Pulse:
    """What a panel is asked for: white from `start_s` on for `on_s`, every `period_s`; arrays that
    fit each other, or numbers."""

    start_s: ArrayLike
    on_s: ArrayLike
    period_s: float


def mean_light(answer: Answer, pulse: Pulse) -> Floats:
    """Mean light of one panel, 0..1:
    ``[A + (f-r)(1-E_r)(1-E_f)/(1-E_r E_f)]/P``."""
    on, period = np.asarray(pulse.on_s, dtype=np.float64), pulse.period_s
    found = np.zeros(())
    for share, rise, fall in answer.parts:
        r, f = _safe(rise), _safe(fall)
        e_r, e_f = np.exp(-on / r), np.exp(-(period - on) / f)
        settled = on + (f - r) * (1.0 - e_r) * (1.0 - e_f) / (1.0 - e_r * e_f)
        found = found + share * settled / period
    return np.asarray(found)


def mean_product(
    projector: Answer, mask: Answer, light: Pulse, opening: Pulse, late_s: ArrayLike
) -> Floats:
    """Mean of the product of both panels, 0..1, the mask's light `late_s` after the projector's.

    light, opening : what projector and mask are asked for, of one period. All arrays broadcast.
    """
    apart = np.asarray(opening.start_s) - np.asarray(light.start_s) + np.asarray(late_s)
    p_on, m_on = np.asarray(light.on_s, np.float64), np.asarray(opening.on_s, np.float64)
    shape = np.broadcast_shapes(apart.shape, p_on.shape, m_on.shape)
    p_on, m_on, apart = (np.broadcast_to(v, shape) for v in (p_on, m_on, apart))
    stretches = _Stretches.of(p_on, m_on, apart, light.period_s)
    found = np.zeros(())
    for p_share, p_rise, p_fall in projector.parts:
        p = _spans(stretches.p_lit, stretches.p_age_s, p_on, light.period_s, p_rise, p_fall)
        for m_share, m_rise, m_fall in mask.parts:
            m = _spans(stretches.m_lit, stretches.m_age_s, m_on, light.period_s, m_rise, m_fall)
            through = _integral(p, m, stretches.length_s) / light.period_s
            found = found + p_share * m_share * through
    return np.asarray(found)


@dataclass(frozen=True)
class _Stretches:
    """A period cut where either panel is asked for something else: (4, ...) each.

    p_lit, m_lit : whether it is asked for white. p_age_s, m_age_s : for how long it has been when
        the stretch begins.
    """

    length_s: Floats
    p_lit: NDArray[np.bool_]
    p_age_s: Floats
    m_lit: NDArray[np.bool_]
    m_age_s: Floats

    @classmethod
    def of(cls, p_on: Floats, m_on: Floats, apart: Floats, period: float) -> _Stretches:
        zero = np.zeros(p_on.shape)
        starts = np.mod(apart, period)
        ends = np.mod(apart + m_on, period)
        cuts = np.sort(np.stack([zero, p_on, starts, ends, zero + period]), axis=0)
        low, length = cuts[:-1], np.diff(cuts, axis=0)
        middle = low + 0.5 * length
        # Which phase a stretch lies in is asked in its middle: at its edges rounding decides.
        p_lit = middle < p_on
        p_age = low - np.where(p_lit, 0.0, p_on)
        since = np.mod(middle - starts, period)
        m_lit = since < m_on
        m_age = np.maximum(since - np.where(m_lit, 0.0, m_on) - 0.5 * length, 0.0)
        return cls(length, p_lit, p_age, m_lit, m_age)


def _spans(
    lit: NDArray[np.bool_],
    age: Floats,
    on: Floats,
    period: float,
    rise: float | Floats,
    fall: float | Floats,
) -> tuple[Floats, Floats, Floats]:
    """Level, deviation from it when a stretch begins, and rate in 1/s of one answer."""
    r, f = _safe(rise), _safe(fall)
    e_r, e_f = np.exp(-on / r), np.exp(-(period - on) / f)
    peak = (1.0 - e_r) / (1.0 - e_r * e_f)
    deviation = np.where(lit, e_f * peak - 1.0, peak)
    rate = np.where(lit, 1.0 / r, 1.0 / f)
    return lit.astype(np.float64), deviation * np.exp(-rate * age), rate


def _integral(
    p: tuple[Floats, Floats, Floats], m: tuple[Floats, Floats, Floats], length: Floats
) -> Floats:
    """Sum over stretches of the integral of (c1 + k1 e^-q1 t)(c2 + k2 e^-q2 t)."""
    (c1, k1, q1), (c2, k2, q2) = p, m

    def faded(rate: Floats) -> Floats:
        return np.asarray(-np.expm1(-rate * length) / rate)

    whole = c1 * c2 * length + c1 * k2 * faded(q2) + k1 * c2 * faded(q1) + k1 * k2 * faded(q1 + q2)
    return np.asarray(whole.sum(axis=0))


def _safe(tau_s: float | Floats) -> Floats:
    return np.maximum(tau_s, SHORTEST_S)


@dataclass(frozen=True)
class Kept:
    """How well a schedule keeps codes apart.

    leak : light of one code that gets through the masks of all others, over that through its own.
    light : what gets through its own, over that of panels that switch at once, one refresh.
    """

    leak: float
    light: float


def kept_apart(
    schedule: ScheduleName, projector: Answer, mask: Answer, late_s: float, refresh_s: float
) -> Kept:
    """How a schedule keeps a code apart from codes that share no cell with it; perfect blacks."""
    lit, opened = (np.flatnonzero(side) for side in SLOTS[schedule])
    slot = len(SLOTS[schedule][0])
    period_s = CODES * slot * refresh_s
    light = Pulse(lit[0] * refresh_s, lit.size * refresh_s, period_s)
    starts = (opened[0] + slot * np.arange(CODES)) * refresh_s
    opening = Pulse(starts, opened.size * refresh_s, period_s)
    through = mean_product(projector, mask, light, opening, late_s)
    own = float(through[0])
    return Kept(
        leak=float(through[1:].sum()) / own if own > 0.0 else float("inf"),
        light=own * period_s / refresh_s,
    )
