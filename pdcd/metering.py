"""From a test exposure to the aperture of the real one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.plan import Plan
from pdcd.recipe import Shot

TARGET = 0.6
"""Where the brightest sample shall lie, as a share of saturation."""

USABLE = (0.02, 0.95)
"""A test exposure whose brightest sample lies outside tells too little: too dark, or clipped."""

METER_PAIRS = 16
"""Pairs of patterns in a test exposure: enough that no cell is far from its mean."""

MAX_TESTS = 6


def metered_pairs(plan: Plan, shot: Shot) -> tuple[int, float]:
    """Pairs of patterns in a test exposure of a shot, and how much more light the shot gathers.

    Exact sequences are shown whole: their first pairs are not like the rest.
    """
    exact = not shot.white and not plan.recipe.programs[shot.program].coded
    pairs = plan.pairs_of(shot) if exact else min(METER_PAIRS, plan.pairs_of(shot))
    return pairs, plan.pairs_of(shot) * plan.passes_of(shot) / pairs


def next_aperture(
    apertures: tuple[float, ...], now: float, peak: float, light_ratio: float
) -> tuple[float, bool]:
    """The aperture to use next, and whether the test exposure was good enough to trust it.

    Parameters
    ----------
    apertures : f-numbers that can be set.
    now : f-number of the test exposure.
    peak : its brightest sample as a share of saturation.
    light_ratio : light of the real exposure over that of the test exposure.
    """
    if peak >= USABLE[1]:
        return at_least(apertures, now * 4.0), now >= max(apertures)
    if peak < USABLE[0] and now > min(apertures):
        brighter = now * np.sqrt(max(peak, 1e-4) / 0.3)
        return at_least(apertures, float(brighter)), False
    wanted = now * np.sqrt(max(peak, 1e-9) * light_ratio / TARGET)
    return at_least(apertures, float(wanted)), True


def peak_share(
    planes: NDArray[np.float32], saturated: NDArray[np.bool_], saturation_dn: float
) -> float:
    """Brightest sample as a share of saturation; 1 when any is saturated."""
    if saturated.any():
        return 1.0
    return float(planes.max()) / saturation_dn


def at_least(apertures: tuple[float, ...], f_number: float) -> float:
    """The widest aperture that is no wider than wanted; the narrowest there is otherwise."""
    return min((a for a in apertures if a >= f_number), default=max(apertures))
