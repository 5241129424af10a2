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
    """

    facts: PanelFacts
    at_s: Floats
    target: Floats
    state: Floats

    def light(self, kind: Ints, late_s: float, t_s: Floats) -> Floats:
        """Light of kinds (n,), set so much after each picture was sent, at times (J,): (n, J)."""
        before = t_s - late_s
        number = np.maximum(np.searchsorted(self.at_s, before, side="right") - 1, 0)
        since = np.maximum(before - self.at_s[number], 0.0)
        up = np.exp(-since / self.facts.rise_s).astype(np.float32)
        down = np.exp(-since / self.facts.fall_s).astype(np.float32)
        target, state = self.target[kind][:, number], self.state[kind][:, number]
        left = state - target
        return np.asarray(target + left * np.where(left < 0.0, up, down))


def follow(facts: PanelFacts, at_s: Floats, shown: Ints, levels: NDArray[np.uint8]) -> Course:
    """The course of a panel that showed picture `shown[e]` from `at_s[e]`, black long before.

    levels : (kinds, P) what each kind is sent in each picture, 0..255; picture -1 is black.
    """
    black = 1.0 / facts.contrast
    light = black + (1.0 - black) * (levels / 255.0) ** facts.gamma
    light = np.concatenate([light, np.full((len(light), 1), black)], axis=1)
    target = light[:, shown]
    state = np.empty_like(target)
    now = np.full(len(light), black)
    for number, lasts_s in enumerate(np.append(np.diff(at_s), 1.0)):
        state[:, number] = now
        goal = target[:, number]
        up, down = np.exp(-lasts_s / facts.rise_s), np.exp(-lasts_s / facts.fall_s)
        now = goal + (now - goal) * np.where(now < goal, up, down)
    return Course(facts, at_s, target.astype(np.float32), state.astype(np.float32))


def delays_s(facts: PanelFacts, bands: int) -> Floats:
    """By how much each band of rows follows the picture that is sent, (bands,)."""
    share = (np.arange(bands) + 0.5) / bands
    down = facts.scan_s > 0
    return facts.late_s + abs(facts.scan_s) * (share if down else 1.0 - share)


def time_steps(
    starts_s: Floats, begin_s: float, end_s: float, step_s: float, fine_s: float
) -> tuple[Floats, Floats]:
    """Times to look at the panels and what each stands for, (J,) both, within an exposure.

    Steps are short for `fine_s` after each picture was sent; then nothing moves any more, and one
    look is enough until the next.
    """
    edges = np.unique(np.clip(np.concatenate([[begin_s], starts_s, [end_s]]), begin_s, end_s))
    times, weights = [], []
    for one, other in pairwise(edges):
        sent = starts_s[starts_s <= one + 1e-12]
        moving = float(np.clip(sent[-1] + fine_s - one, 0.0, other - one)) if sent.size else 0.0
        if moving > 0.0:
            count = max(1, round(moving / step_s))
            times.append(one + (np.arange(count) + 0.5) * moving / count)
            weights.append(np.full(count, moving / count))
        if other - one > moving:
            times.append(np.array([other - 1e-9]))
            weights.append(np.array([other - one - moving]))
    return np.concatenate(times), np.concatenate(weights)
