"""Radial and tangential distortion of a lens (Brown 1966, Decentering Distortion of Lenses).

Points are in units of half the height of the picture, from its centre: with r their distance from
there,

    straight = seen (1 + k1 r^2 + k2 r^4) + 2 (P . seen) seen + r^2 P,    P = (p2, p1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Pair = tuple[float, float]


def straightened(near: Floats, radial: Pair, tangential: Pair) -> Floats:
    """Seen points (..., 2) -> straight ones, (..., 2)."""
    (k1, k2), (p1, p2) = radial, tangential
    x, y = near[..., 0], near[..., 1]
    r2 = x * x + y * y
    # 2 (P . seen) goes into the factor: it, too, lengthens the way from the centre.
    factor = 1.0 + r2 * (k1 + k2 * r2) + 2.0 * (p2 * x + p1 * y)
    straight = np.empty(near.shape)
    straight[..., 0] = x * factor + p2 * r2
    straight[..., 1] = y * factor + p1 * r2
    return straight


def slope(near: Floats, radial: Pair, tangential: Pair) -> Floats:
    """How straight points move with seen ones: (..., 2, 2), d(straight) / d(seen)."""
    (k1, k2), (p1, p2) = radial, tangential
    x, y = near[..., 0], near[..., 1]
    r2 = x * x + y * y
    factor, rate = 1.0 + r2 * (k1 + k2 * r2), 2.0 * k1 + 4.0 * k2 * r2
    found = np.empty((*near.shape, 2))
    found[..., 0, 0] = factor + rate * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    found[..., 0, 1] = found[..., 1, 0] = rate * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    found[..., 1, 1] = factor + rate * y * y + 2.0 * p2 * x + 6.0 * p1 * y
    return found


def fold(radial: Pair) -> float:
    """The distance from the centre at which the radial part folds; infinite where it never does.

    Beyond it a straight point may be seen twice, and only the one within is on the picture.
    """
    k1, k2 = radial
    # The smallest positive root u = r^2 of 1 + 3 k1 u + 5 k2 u^2.
    roots = np.roots([5.0 * k2, 3.0 * k1, 1.0])
    folds = roots.real[(np.abs(roots.imag) == 0.0) & (roots.real > 0.0)]
    return float(np.sqrt(folds.min())) if folds.size else float("inf")
