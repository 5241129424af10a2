"""How much light a grey level gives, and which level to send for some light.

Panels take 8 bits. Grey patterns in `pdcd.panels` hold what is *sent*, as level / 255; a curve says
what light that is. Black and white are black and white under any curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.patterns import Patterns, levels_of

Floats = NDArray[np.float64]
_Real = TypeVar("_Real", np.float32, np.float64)

LEVELS = 256
"""Levels of a panel."""


@dataclass(frozen=True, eq=False)
class Curve:
    """`light` (256,) float64: what each level gives, over full light; 0 first, 1 last, never
    falling. Read-only."""

    light: Floats

    def sent(self, light: Floats) -> Floats:
        """Light 0..1 of any shape -> the level whose light is nearest, over 255."""
        between = 0.5 * (self.light[1:] + self.light[:-1])
        return np.searchsorted(between, light) / (LEVELS - 1.0)

    def given(self, sent: NDArray[_Real]) -> Floats:
        """What is sent, level / 255 -> light 0..1; in between it is rounded as drawing does."""
        return self.of(np.rint(sent * (LEVELS - 1.0)).astype(np.uint8))

    def of(self, level: NDArray[np.uint8]) -> Floats:
        """Levels 0..255 -> light 0..1."""
        return np.asarray(self.light[level])


Curves = tuple[Curve | None, Curve | None]
"""Of projector and mask; None where nobody said: what is sent is then taken as light."""
UNKNOWN: Curves = (None, None)


@lru_cache(maxsize=16)
def power(gamma: float) -> Curve:
    """The curve ``(level / 255)^gamma``."""
    return _curve((np.arange(LEVELS) / (LEVELS - 1.0)) ** gamma)


@lru_cache(maxsize=16)
def table(lights: tuple[float, ...]) -> Curve:
    """The curve through lights at evenly spaced levels, the first of 0, the last of 255; straight
    lines between them. Check them first with `table_fault`."""
    at = np.linspace(0.0, LEVELS - 1.0, len(lights))
    return _curve(np.interp(np.arange(LEVELS), at, lights))


def table_fault(lights: Sequence[float]) -> str:
    """What is wrong with the lights of a table, in words; "" for nothing."""
    if not 2 <= len(lights) <= LEVELS:
        return f"needs 2 to {LEVELS} lights, not {len(lights)}"
    found = np.array(lights, dtype=np.float64)
    if not np.isfinite(found).all() or found[0] != 0.0 or found[-1] != 1.0:
        return "must begin with 0, the light of black, and end with 1, that of white"
    if np.any(np.diff(found) < 0.0):
        at = int(np.argmin(np.diff(found)))
        return f"falls from {found[at]:g} to {found[at + 1]:g}: light must rise with the level"
    return ""


def light_of(patterns: Patterns, index: int, cells: int, curve: Curve | None) -> Floats:
    """Light of one pattern, (L,) float64."""
    sent = levels_of(patterns, index, cells)
    if curve is None or patterns.dtype == np.uint8:
        return sent
    return curve.given(sent)


def _curve(light: Floats) -> Curve:
    light.flags.writeable = False
    return Curve(light)
