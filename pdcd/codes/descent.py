"""The least value of a smooth function of very many numbers between 0 and 1."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Function = Callable[[Singles], tuple[float, Singles]]
"""Value and slope at a place."""

KEPT = 10
"""Steps from which the curvature is estimated."""
FIRST = 0.1
"""How far the first step moves any number at most."""
SHORTER, TRIES = 0.35, 10
"""A step after which the value is not lower is shortened by this factor, so often at most."""
LEAST = 1e-7
"""Share of the value that a step must bring to be followed by another: what float32 tells apart."""
TINY = 1e-30
"""No slope at all."""
ENOUGH = 1e-4
"""Share of the fall that the slope promises which a step must bring (Armijo)."""


def descended(function: Function, start: Singles, steps: int) -> Singles:
    """Where at most so many steps of descent from `start` lead; all numbers stay between 0 and 1.

    Steps go by the slope and by the curvature that the last steps met (limited-memory BFGS, Nocedal
    and Wright 2006, algorithm 7.4), of those numbers alone that are not held by their bounds. To
    reach the same value `scipy.optimize` takes three times as long for the codes that this is for,
    as it sorts all numbers by their bounds at each step and counts in float64.
    """
    place = start
    value, slope = function(place)
    met: list[tuple[Singles, Singles, float]] = []
    for _ in range(steps):
        held = ((place <= 0.0) & (slope > 0.0)) | ((place >= 1.0) & (slope < 0.0))
        way = _way(np.where(held, np.float32(0.0), slope), met)
        way[held] = 0.0
        step = _step(function, place, value, slope, way)
        if step is None and not met:
            break
        if step is None:
            # What was met before misleads here.
            met = []
            continue
        after, low, new_slope = step
        if value - low < LEAST * abs(value):
            return after
        value = low
        moved, bent = after - place, new_slope - slope
        curved = dot(moved, bent)
        if curved > 0.0:
            met = [*met[1 - KEPT :], (moved, bent, 1.0 / curved)]
        place, slope = after, new_slope
    return place


def _way(slope: Singles, met: list[tuple[Singles, Singles, float]]) -> Singles:
    """Minus the slope times the inverse of the curvature that was met."""
    way = -slope
    if not met:
        way *= np.float32(FIRST / max(float(np.abs(way).max()), TINY))
        return way
    shares = []
    for moved, bent, scale in reversed(met):
        share = scale * dot(moved, way)
        shares.append(share)
        way -= np.float32(share) * bent
    moved, bent, scale = met[-1]
    way *= np.float32(1.0 / (scale * dot(bent, bent)))
    for (moved, bent, scale), share in zip(met, reversed(shares), strict=True):
        way += np.float32(share - scale * dot(bent, way)) * moved
    return way


def _step(
    function: Function, place: Singles, value: float, slope: Singles, way: Singles
) -> tuple[Singles, float, Singles] | None:
    """The first place on the way, of ever nearer ones, where the value is low enough; its value and
    slope. None where the way leads up, or none of them is."""
    if dot(way, slope) >= 0.0:
        return None
    length = 1.0
    for _ in range(TRIES):
        after = np.clip(place + np.float32(length) * way, 0.0, 1.0)
        low, new_slope = function(after)
        if low <= value + ENOUGH * dot(slope, after - place):
            return after, low, new_slope
        length *= SHORTER
    return None


def dot(one: Singles, other: Singles) -> float:
    """Sum of the products of all numbers."""
    return float(np.vdot(one, other))
