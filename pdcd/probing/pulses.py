"""Two panels that pulse in step: how much light gets through both, in closed form.

Panels are asked for black or white refresh by refresh, again and again. One that is asked for white
goes up by ``1 - (1-x) exp(-t/r)``, otherwise down by ``x exp(-t/f)``. So over a refresh its light
is a constant and an exponential; the light at the beginning of the first one is that at the end of
the last. The mask's refreshes begin some time after the projector's, so that each refresh falls
into two stretches. Over a stretch the product of both panels is an integral of two exponentials.

`pdcd.probing.realised` computes the same for any exposure. This module does it for endless pulses,
some thousand times faster, as a fit needs it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdcd.arrays import Bools, Floats
from pdcd.panels.schedule import SLOTS
from pdcd.words import ScheduleName

_SHORTEST_S = 1e-7
"""Shortest time constant: a camera cannot see a difference between shorter ones."""
_CODES = 12
"""Codes in a cycle, for the light of one code that gets into the others: far ones get none."""


@dataclass(frozen=True)
class PanelResponse:
    """How a panel responds, in s: first order, or two such responses at once.

    tail, slower : the share `tail` of the light rises and falls `slower` times as slowly.

    The fields may be arrays of responses, if they broadcast with what they are asked for.
    """

    rise_s: float | Floats
    fall_s: float | Floats
    tail: float | Floats = 0.0
    slower: float | Floats = 1.0

    @property
    def parts(self) -> list[tuple[float | Floats, float | Floats, float | Floats]]:
        """Share, rise and fall of each first-order response that it is the sum of."""
        if not np.any(self.tail):
            return [(1.0, self.rise_s, self.fall_s)]
        return [
            (1.0 - self.tail, self.rise_s, self.fall_s),
            (self.tail, self.rise_s * self.slower, self.fall_s * self.slower),
        ]


def compute_pulse_light(answer: PanelResponse, on: Bools, refresh_s: float) -> Floats:
    """Mean light of one panel, 0..1. on : (..., n) whether it is asked for white, by refresh."""
    found = np.zeros(())
    for share, rise, fall in answer.parts:
        course = _Course.of(on, rise, fall, refresh_s)
        light = course.level * refresh_s + course.above * _faded(course.rate, refresh_s)
        found = found + share * light.mean(axis=-1) / refresh_s
    return np.asarray(found)


def compute_pulse_product(
    projector: PanelResponse,
    mask: PanelResponse,
    lit: Bools,
    opened: Bools,
    late_s: ArrayLike,
    refresh_s: float,
) -> Floats:
    """Mean of the product of both panels, 0..1, with the mask's light `late_s` after the
    projector's.

    lit, opened : (..., n) whether projector and mask are asked for white, by refresh. late_s and
        times of the responses broadcast with the axes in front of the refreshes.
    """
    late = np.asarray(late_s, dtype=np.float64)
    whole = np.floor(late / refresh_s)
    before_s = (late - whole * refresh_s)[..., None]
    refresh = np.arange(lit.shape[-1])
    behind = (refresh - whole[..., None].astype(np.int64)) % lit.shape[-1]
    found = np.zeros(())
    for p_share, p_rise, p_fall in projector.parts:
        p = _Course.of(lit, p_rise, p_fall, refresh_s)
        for m_share, m_rise, m_fall in mask.parts:
            m = _Course.of(opened, m_rise, m_fall, refresh_s)
            last = m.taken(behind - 1).aged(refresh_s - before_s)
            light = _integral(p, last, before_s)
            light = light + _integral(p.aged(before_s), m.taken(behind), refresh_s - before_s)
            found = found + p_share * m_share * light.mean(axis=-1) / refresh_s
    return np.asarray(found)


@dataclass(frozen=True)
class _Course:
    """Light of one panel in each refresh, (..., n): ``level + above exp(-rate t)``, in 1/s."""

    level: Floats
    above: Floats
    rate: Floats

    @classmethod
    def of(
        cls, on: Bools, rise_s: float | Floats, fall_s: float | Floats, refresh_s: float
    ) -> _Course:
        rise, fall = (np.maximum(tau, _SHORTEST_S)[..., None] for tau in (rise_s, fall_s))
        rate = np.where(on, 1.0 / rise, 1.0 / fall)
        kept, level = np.exp(-rate * refresh_s), on.astype(np.float64)
        # Over all refreshes the initial light is multiplied and added to: one initial light is the
        # same at the end.
        light, share = np.zeros(rate.shape[:-1]), np.ones(rate.shape[:-1])
        for k in range(on.shape[-1]):
            light = level[..., k] + (light - level[..., k]) * kept[..., k]
            share = share * kept[..., k]
        light = light / (1.0 - share)
        above = np.empty(rate.shape)
        for k in range(on.shape[-1]):
            above[..., k] = light - level[..., k]
            light = level[..., k] + above[..., k] * kept[..., k]
        return cls(level, above, rate)

    def taken(self, refresh: NDArray[np.int64]) -> _Course:
        """The same in other refreshes, numbers (..., n)."""
        shape = np.broadcast_shapes(self.above.shape, refresh.shape)
        at = np.broadcast_to(refresh % shape[-1], shape)
        level, above, rate = (
            np.take_along_axis(np.broadcast_to(part, shape), at, axis=-1)
            for part in (self.level, self.above, self.rate)
        )
        return _Course(level, above, rate)

    def aged(self, by_s: Floats) -> _Course:
        """The same, later by some time in each refresh."""
        return _Course(self.level, self.above * np.exp(-self.rate * by_s), self.rate)


def _integral(p: _Course, m: _Course, length_s: Floats) -> Floats:
    """Light through both over a stretch of each refresh, in s."""
    return np.asarray(
        p.level * m.level * length_s
        + p.level * m.above * _faded(m.rate, length_s)
        + p.above * m.level * _faded(p.rate, length_s)
        + p.above * m.above * _faded(p.rate + m.rate, length_s)
    )


def _faded(rate: Floats, length_s: float | Floats) -> Floats:
    """Integral of exp(-rate t), in s."""
    return np.asarray(-np.expm1(-rate * length_s) / rate)


@dataclass(frozen=True)
class CodeSeparation:
    """How well a schedule keeps codes apart.

    leak : light of one code that gets through the masks of all others, over that through its own.
    light : light through its own mask, over that of panels that switch at once, one refresh.
    """

    leak: float
    light: float


def compute_code_separation(
    schedule: ScheduleName,
    projector: PanelResponse,
    mask: PanelResponse,
    late_s: float,
    refresh_s: float,
) -> CodeSeparation:
    """How a schedule separates a code from codes without a common cell, with perfect blacks."""
    lit, opened = (np.asarray(side, dtype=np.bool_) for side in SLOTS[schedule])
    codes = np.arange(_CODES)
    light, opening = np.zeros((2, _CODES, _CODES, lit.size), dtype=np.bool_)
    light[:, 0], opening[codes, codes] = lit, opened  # the first code's light, each code's mask
    asked = light.reshape(_CODES, -1), opening.reshape(_CODES, -1)
    through = compute_pulse_product(projector, mask, asked[0], asked[1], late_s, refresh_s)
    own = float(through[0])
    return CodeSeparation(
        leak=float(through[1:].sum()) / own if own > 0.0 else float("inf"),
        light=own * _CODES * lit.size,
    )
