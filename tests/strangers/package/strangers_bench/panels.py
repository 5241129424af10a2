"""How the pixels of a panel brighten and darken, step by step in time.

A pixel follows what it is told: its light goes towards the new one as a liquid crystal does, with
one time constant upwards and another downwards, from when its row is set. Pixels that are told the
same at all times are one *kind*. Rows are taken in bands, each with its delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .facts import PanelFacts

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Picture = NDArray[np.uint8]

_FEW = 12
"""Pictures of black and white up to which the kinds of pixels are counted out."""
GROWS = 1.25
"""How much longer each step of time is than the one before, where light only settles."""
_MIX = np.uint64(0x9E3779B97F4A7C15)


def sort_pixels(pictures: Sequence[Picture]) -> tuple[Ints, NDArray[np.uint8]]:
    """Kinds of pixels: the kind of each, (pixels,), and what each kind is sent, (kinds, P)."""
    flat = [picture.ravel() for picture in pictures]
    if len(flat) <= _FEW and all(bool(np.all((f == 0) | (f == 255))) for f in flat):
        code = np.zeros(flat[0].size, dtype=np.int64)
        for place, one in enumerate(flat):
            code |= (one & 1).astype(np.int64) << place
        first = np.full(1 << len(flat), -1)
        first[code[::-1]] = np.arange(code.size)[::-1]
        used = np.flatnonzero(first >= 0)
        number = np.zeros(first.size, dtype=np.int64)
        number[used] = np.arange(used.size)
        kind, where = number[code], first[used]
    else:
        mixed = np.zeros(flat[0].size, dtype=np.uint64)
        for one in flat:
            mixed = (mixed ^ (one.astype(np.uint64) + np.uint64(1))) * _MIX
            mixed ^= mixed >> np.uint64(29)
        _, where, kind = np.unique(mixed, return_index=True, return_inverse=True)
    return kind.ravel(), np.stack([one[where] for one in flat], axis=1)


@dataclass(frozen=True, eq=False)
class Course:
    """What a panel showed in an exposure, by kinds of pixels.

    at_s : (E,) when each picture was sent.
    target : (kinds, E) light that each kind is told to give from then on, 0..1.
    state : (kinds, E) light that it gives when its row is set.
    total : (kinds, E) light that it gave from the first row until then, times s.
    """

    facts: PanelFacts
    at_s: Floats
    target: Floats
    state: Floats
    total: Floats

    def steps(self, kind: Ints, late_s: float, edges_s: Floats) -> tuple[Floats, Floats]:
        """Light of kinds (n,), set so much after each picture was sent, in steps of time between
        edges (J + 1,): its sum over each step, and by how much it grew, (n, J) both."""
        before = edges_s - late_s
        number = np.maximum(np.searchsorted(self.at_s, before, side="right") - 1, 0)
        since = before - self.at_s[number]
        early, since = np.minimum(since, 0.0), np.maximum(since, 0.0)
        up, down = (np.exp(-since / tau) for tau in (self.facts.rise_s, self.facts.fall_s))
        target, state = self.target[kind][:, number], self.state[kind][:, number]
        left = state - target
        darker = left < 0.0
        moved = np.where(darker, self.facts.rise_s * (1.0 - up), self.facts.fall_s * (1.0 - down))
        total = self.total[kind][:, number] + target * since + left * moved + state * early
        light = target + left * np.where(darker, up, down)
        return np.diff(total, axis=1), np.diff(light, axis=1)


def follow(facts: PanelFacts, at_s: Floats, shown: Ints, levels: NDArray[np.uint8]) -> Course:
    """The course of a panel that showed picture `shown[e]` from `at_s[e]`, black long before.

    levels : (kinds, P) what each kind is sent in each picture, 0..255; picture -1 is black.
    """
    black = 1.0 / facts.contrast
    light = black + (1.0 - black) * (levels / 255.0) ** facts.gamma
    light = np.concatenate([light, np.full((len(light), 1), black)], axis=1)
    target = light[:, shown]
    state, total = np.empty_like(target), np.empty_like(target)
    now, given = np.full(len(light), black), np.zeros(len(light))
    for number, lasts_s in enumerate(np.append(np.diff(at_s), 1.0)):
        state[:, number], total[:, number] = now, given
        goal = target[:, number]
        tau = np.where(now < goal, facts.rise_s, facts.fall_s)
        left = np.exp(-lasts_s / tau)
        given = given + goal * lasts_s + (now - goal) * tau * (1.0 - left)
        now = goal + (now - goal) * left
    return Course(facts, at_s, target, state, total)


def delays_s(facts: PanelFacts, bands: int) -> Floats:
    """By how much each band of rows follows the picture that is sent, (bands,)."""
    share = (np.arange(bands) + 0.5) / bands
    down = facts.scan_s > 0
    return facts.late_s + abs(facts.scan_s) * (share if down else 1.0 - share)


def time_steps(
    starts_s: Floats, begin_s: float, end_s: float, step_s: float, fine_s: float, settles_s: float
) -> Floats:
    """Edges of the steps of time in which the panels are looked at, within an exposure.

    Steps are short for `fine_s` after each picture was sent, and then ever longer until it has
    settled; then nothing moves any more, and one step leads to the next.
    """
    grown = [fine_s]
    while grown[-1] < settles_s:
        grown.append(grown[-1] + step_s * GROWS ** len(grown))
    edges = np.unique(np.clip(np.concatenate([[begin_s], starts_s, [end_s]]), begin_s, end_s))
    found = []
    for one, other in pairwise(edges):
        sent = starts_s[starts_s <= one + 1e-12]
        found.append(np.array([one]))
        if sent.size:
            moving = float(np.clip(sent[-1] + fine_s - one, 0.0, other - one))
            found.append(one + np.linspace(0.0, moving, max(1, round(moving / step_s)) + 1)[1:])
            found.append(sent[-1] + np.array(grown))
            found[-1] = found[-1][(found[-1] > one) & (found[-1] < other)]
    return np.unique(np.concatenate([*found, edges[-1:]]))
