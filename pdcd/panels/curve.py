"""How much light a grey level gives, and which level to send for some light.

Panels take 8 bits. Grey patterns in `pdcd.panels` hold what is *sent*, as level / 255; a curve
gives the light of that. Black and white are black and white under any curve.

Grey levels finer than 8 bits: a later pattern compensates for the rounding of an earlier one. A
photo is a sum over its patterns, so a level between two steps of a panel is shown as a mix of both.
The rounding error is carried from pattern to pattern, cell by cell:

- codes: in two accounts, one for patterns in which the other panel lets light pass at the same
  cell, one for all others. So a cell's light through itself and that through all other cells are
  right to a fraction of a step, however many patterns there are;
- exact sequences, which are shown over and over: from each copy of a pattern to its next one. The
  last two compensate for the rest together: if levels are not evenly spaced, two that lie some
  steps apart often come nearer to it than two neighbours.

Black and white are never changed: a closed cell stays closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.panels.patterns import Patterns, pack_levels, read_pattern_levels

_Real = TypeVar("_Real", np.float32, np.float64)

PANEL_LEVELS = 256
"""Levels of a panel."""


@dataclass(frozen=True, eq=False)
class Curve:
    """`light` (256,) float64: the light of each level, over full light; 0 first, 1 last, never
    falling. Read-only."""

    light: Floats

    def sent(self, light: Floats) -> Floats:
        """Light 0..1 of any shape -> the level with the nearest light, over 255."""
        between = 0.5 * (self.light[1:] + self.light[:-1])
        return np.searchsorted(between, light) / (PANEL_LEVELS - 1.0)

    def given(self, sent: NDArray[_Real]) -> Floats:
        """What is sent, level / 255 -> light 0..1; values between levels are rounded as drawn."""
        return self.of(np.rint(sent * (PANEL_LEVELS - 1.0)).astype(np.uint8))

    def of(self, level: NDArray[np.uint8]) -> Floats:
        """Levels 0..255 -> light 0..1."""
        return np.asarray(self.light[level])


Curves = tuple[Curve | None, Curve | None]
"""Curves of projector and mask; None where unknown: what is sent is then taken as light."""
UNKNOWN_CURVES: Curves = (None, None)


@lru_cache(maxsize=16)
def make_power_curve(gamma: float) -> Curve:
    """The curve ``(level / 255)^gamma``."""
    return _curve((np.arange(PANEL_LEVELS) / (PANEL_LEVELS - 1.0)) ** gamma)


@lru_cache(maxsize=16)
def make_table_curve(lights: tuple[float, ...]) -> Curve:
    """The curve through lights at evenly spaced levels, the first at 0, the last at 255, with
    straight lines between them. Check them first with `find_table_fault`."""
    at = np.linspace(0.0, PANEL_LEVELS - 1.0, len(lights))
    return _curve(np.interp(np.arange(PANEL_LEVELS), at, lights))


def find_table_fault(lights: Sequence[float]) -> str:
    """What is wrong with the lights of a table, in words; "" for nothing."""
    if not 2 <= len(lights) <= PANEL_LEVELS:
        return f"needs 2 to {PANEL_LEVELS} lights, not {len(lights)}"
    found = np.array(lights, dtype=np.float64)
    if not np.isfinite(found).all() or found[0] != 0.0 or found[-1] != 1.0:
        return "must begin with 0, the light of black, and end with 1, that of white"
    if np.any(np.diff(found) < 0.0):
        at = int(np.argmin(np.diff(found)))
        return f"falls from {found[at]:g} to {found[at + 1]:g}: light must rise with the level"
    return ""


def compute_pattern_light(
    patterns: Patterns, index: int, cells: int, curve: Curve | None
) -> Floats:
    """Light of one pattern, (L,) float64."""
    sent = read_pattern_levels(patterns, index, cells)
    if curve is None or patterns.dtype == np.uint8:
        return sent
    return curve.given(sent)


def _curve(light: Floats) -> Curve:
    light.flags.writeable = False
    return Curve(light)


_Levels = Floats | Bools
_Both = tuple[Patterns, Patterns]

COPIES = 16
"""Most copies of an exact sequence: steps become a sixteenth as large."""
_APART = 12
"""Most levels between the last copy but one and the nearest level. If light rises with the power
2.2 of the level, two a dozen steps to either side give a step more than twice the middle."""
_NEARER = 1e-6
"""Light by which such a pair must come nearer; else the pair with fewer steps between is taken."""


def prepare_codes(light: _Levels, mask: _Levels, curves: Curves) -> _Both:
    """Codes of projector and mask, light 0..1 or bits (P, L) each, as what is sent for them."""
    return (
        pack_levels(_dithered(light, curves[0], mask > 0)),
        pack_levels(_dithered(mask, curves[1], light > 0)),
    )


def prepare_sequence(light: _Levels, mask: _Levels, curves: Curves, room: int) -> _Both:
    """The same for an exact sequence that is shown `room` times. If it has grey levels, the result
    has up to so many copies, one after the other: (copies * P, L)."""
    both = ((light, curves[0]), (mask, curves[1]))
    grey = [_rounds(*panel) for panel in both]
    copies = min(max(room, 1), COPIES) if any(grey) else 1
    sent = []
    for panel, (levels, curve) in enumerate(both):
        # Every cell of every pattern has an account of its own.
        each = np.repeat(np.asarray(levels, np.float64).reshape(1, -1), copies, axis=0)
        mixed = _dithered(each, curve, np.ones(each.shape, np.bool_))
        if curve is not None and grey[panel] and copies >= 2 * sum(grey):
            last = _last_two(each[0], mixed, curve)
            # Not in the copies in which the other panel deviates: their product would not cancel.
            mixed = np.roll(np.concatenate([mixed[:-2], last]), panel * (copies // 2), axis=0)
        sent.append(pack_levels(mixed.reshape(-1, levels.shape[1])))
    return sent[0], sent[1]


def _last_two(light: _Levels, sent: _Levels, curve: Curve) -> Floats:
    """What to send last, (2, L), so that the sum of all copies `sent` (n, L) is n times `light`."""
    grey = (light > 0.0) & (light < 1.0)
    before = curve.given(np.asarray(sent[:-2], np.float64))
    left: Floats = len(sent) * light - before.sum(axis=0)
    middle = np.rint(curve.sent(0.5 * left) * (PANEL_LEVELS - 1.0))
    found, least = sent[-2:].astype(np.float64), np.full(light.shape, np.inf)
    for apart in sorted(range(-_APART, _APART + 1), key=abs):
        first = np.clip(middle + apart, 0.0, PANEL_LEVELS - 1.0) / (PANEL_LEVELS - 1.0)
        rest = left - curve.given(first)
        second = curve.sent(rest)
        error = np.abs(rest - curve.given(second))
        better = grey & (error < least - _NEARER)
        least = np.where(better, error, least)
        found = np.where(better, np.stack([first, second]), found)
    return found


def _rounds(light: _Levels, curve: Curve | None) -> bool:
    """Whether levels must be rounded: they are not bits, and the panel's curve is known."""
    if curve is None or light.dtype == np.bool_:
        return False
    return not bool(np.all((light == 0.0) | (light == 1.0)))


def _dithered(light: _Levels, curve: Curve | None, meets: Bools) -> _Levels:
    """What to send for light (P, L), over 255; `meets` (P, L) says which account a cell is in."""
    if curve is None or not _rounds(light, curve):
        return light
    sent = np.empty(light.shape)
    owed = np.zeros((2, light.shape[1]))
    for k, wanted in enumerate(light):
        carried = np.where(meets[k], owed[1], owed[0])
        grey = (wanted > 0.0) & (wanted < 1.0)
        aim = wanted + carried
        sent[k] = np.where(grey, curve.sent(aim), wanted)
        left = np.where(grey, aim - curve.given(sent[k]), carried)
        owed = np.stack([np.where(meets[k], owed[0], left), np.where(meets[k], left, owed[1])])
    return sent
