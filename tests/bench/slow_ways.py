"""Two other ways to the realised probing matrix, written to be as fast as such a way can be.

Both follow every pair of panel pixels: by time steps, or exactly from one change of a panel to the
next. Pixels are squares of 1/`fine` cell. Outer products are gathered in blocks, so that the work
is matrix products at the speed of the machine rather than passes over memory.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from pdcd.probing.panel import PanelOptics, compute_decay_integral
from tests.oracles import Timeline

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

BLOCK = 256
"""Outer products that are summed by one matrix product."""

Interval = tuple[float, Bools, Bools]
"""Duration in s, and what the mask and the projector are asked meanwhile, (P,) each."""


def intervals(primal: Timeline, dual: Timeline, exposure_s: float) -> list[Interval]:
    """The exposure cut where either panel gets a new target."""
    edges = np.unique(np.concatenate([primal.start_s, dual.start_s, [0.0, exposure_s]]))
    edges = edges[(edges >= 0.0) & (edges <= exposure_s)]
    at_primal = np.searchsorted(primal.start_s, edges, side="right") - 1
    at_dual = np.searchsorted(dual.start_s, edges, side="right") - 1
    return [
        (float(hi - lo), dual.on[d], primal.on[p])
        for (lo, hi), d, p in zip(itertools.pairwise(edges), at_dual, at_primal, strict=False)
    ]


def stepped(
    cuts: list[Interval], primal: PanelOptics, dual: PanelOptics, steps_per_s: float
) -> Floats:
    """Time steps by the midpoint rule, which is of second order: (P, P), mask by projector."""
    pixels = cuts[0][1].size
    masks, lights = _Block(pixels), _Block(pixels)
    total = np.zeros((pixels, pixels))
    mask, light = np.full(pixels, dual.leak), np.full(pixels, primal.leak)
    for duration_s, mask_on, light_on in cuts:
        steps = max(1, math.ceil(duration_s * steps_per_s))
        h = duration_s / steps
        mask_goal, mask_rate = _response(dual, mask_on)
        light_goal, light_rate = _response(primal, light_on)
        for _ in range(steps):
            half_mask = mask + 0.5 * h * mask_rate * (mask_goal - mask)
            half_light = light + 0.5 * h * light_rate * (light_goal - light)
            masks.add(h * half_mask)
            lights.add(half_light)
            mask = mask + h * mask_rate * (mask_goal - half_mask)
            light = light + h * light_rate * (light_goal - half_light)
            if masks.full:
                total += masks.take().T @ lights.take()
    total += masks.take().T @ lights.take()
    return total


def dense(cuts: list[Interval], primal: PanelOptics, dual: PanelOptics) -> Floats:
    """Exact integrals between changes: (P, P), mask by projector.

    Within one interval a panel is a constant and two decaying fields (pixels on their way to white
    and to black), so an interval adds a product of rank 3.
    """
    pixels = cuts[0][1].size
    masks, lights = _Block(pixels), _Block(pixels)
    total = np.zeros((pixels, pixels))
    mask, light = np.full(pixels, dual.leak), np.full(pixels, primal.leak)
    for duration_s, mask_on, light_on in cuts:
        mask_fields, mask = _fields(dual, mask_on, mask, duration_s)
        light_fields, light = _fields(primal, light_on, light, duration_s)
        rates = _rates(dual)[:, None] + _rates(primal)[None, :]
        weighted = compute_decay_integral(rates, np.asarray(duration_s)) @ light_fields
        for row in range(3):
            masks.add(mask_fields[row])
            lights.add(weighted[row])
        if masks.full:
            total += masks.take().T @ lights.take()
    total += masks.take().T @ lights.take()
    return total


class _Block:
    """Rows (P,) gathered until there are enough for one matrix product."""

    def __init__(self, pixels: int) -> None:
        self._rows = np.empty((BLOCK, pixels))
        self._used = 0

    @property
    def full(self) -> bool:
        """Whether another three rows might not fit."""
        return self._used > BLOCK - 3

    def add(self, row: Floats) -> None:
        self._rows[self._used] = row
        self._used += 1

    def take(self) -> Floats:
        """The rows so far, (R, P); valid until the next `add`."""
        rows = self._rows[: self._used]
        self._used = 0
        return rows


def _response(panel: PanelOptics, on: Bools) -> tuple[Floats, Floats]:
    """Level that each pixel tends to, and its rate in 1/s."""
    return np.where(on, 1.0, panel.leak), 1.0 / np.where(on, panel.rise_s, panel.fall_s)


def _rates(panel: PanelOptics) -> Floats:
    """Rates in 1/s of the three fields: constant, towards white, towards black."""
    return np.array([0.0, 1.0 / panel.rise_s, 1.0 / panel.fall_s])


def _fields(
    panel: PanelOptics, on: Bools, state: Floats, duration_s: float
) -> tuple[Floats, Floats]:
    """Fields at the start of an interval, (3, P), and the state at its end, (P,)."""
    goal = np.where(on, 1.0, panel.leak)
    away = state - goal
    fields = np.stack([goal, np.where(on, away, 0.0), np.where(on, 0.0, away)])
    return fields, np.exp(-_rates(panel) * duration_s) @ fields
