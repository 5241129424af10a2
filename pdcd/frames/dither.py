"""Grey levels finer than 8 bits: what one pattern rounds off, a later one makes up for.

A photo is a sum over its patterns, so a level between two steps of a panel is shown as a mix of
both. What is off is carried from pattern to pattern, cell by cell:

- codes: in two accounts, one of patterns in which the other panel lets light pass at the same cell,
  one of all others. So a cell's light through itself and that through all other cells come out to a
  fraction of a step, however many patterns there are;
- exact sequences, which are shown over and over: from each copy of a pattern to its next one.

Black and white are never touched: a closed cell stays closed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.frames.curve import Curve, Curves
from pdcd.frames.patterns import Patterns, compact

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Levels = Floats | Bools
Both = tuple[Patterns, Patterns]

COPIES = 16
"""Most copies of an exact sequence: steps become a sixteenth as large."""


def code_to_send(light: Levels, mask: Levels, curves: Curves) -> Both:
    """Codes of projector and mask, light 0..1 or bits (P, L) each, as what is sent for them."""
    return (
        compact(_dithered(light, curves[0], mask > 0)),
        compact(_dithered(mask, curves[1], light > 0)),
    )


def sequence_to_send(light: Levels, mask: Levels, curves: Curves, room: int) -> Both:
    """The same of an exact sequence that is shown `room` times; where it has grey levels, as up to
    so many copies, one after the other: (copies * P, L)."""
    both = ((light, curves[0]), (mask, curves[1]))
    copies = min(max(room, 1), COPIES) if any(_rounds(*panel) for panel in both) else 1
    sent = []
    for levels, curve in both:
        # Every cell of every pattern has an account of its own.
        each = np.repeat(np.asarray(levels, np.float64).reshape(1, -1), copies, axis=0)
        mixed = _dithered(each, curve, np.ones(each.shape, np.bool_))
        sent.append(compact(mixed.reshape(-1, levels.shape[1])))
    return sent[0], sent[1]


def _rounds(light: Levels, curve: Curve | None) -> bool:
    """Whether levels must be rounded: no bits, and of a panel of which something is known."""
    if curve is None or light.dtype == np.bool_:
        return False
    return not bool(np.all((light == 0.0) | (light == 1.0)))


def _dithered(light: Levels, curve: Curve | None, meets: Bools) -> Levels:
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
