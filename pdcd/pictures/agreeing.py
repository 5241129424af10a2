"""What windows of a photo agree on: an affine map of where a pattern lies, and its bends."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.pictures.raster import AffineMap

FEWEST = 12
"""Windows that must agree on where a pattern is."""
WINDOW_OVERLAP = 2.0
"""Windows that carry as much information as one by itself, as they overlap."""
_COHERENT_PX = 2.0
"""By how much windows may differ from those beside them, in projector pixels."""
_BENT_PX, _FEWEST_BENT = 0.5, 30
"""RMS from which residuals of the map are a bend, in projector pixels, and windows it takes."""


def fit_bend(centres: Floats, left: Floats) -> Callable[[Floats], Floats]:
    """The cubic polynomials that residuals (n, 2) of a map follow at `centres` (n, 2), as functions
    of points (..., 2). They are 0 where the residuals are hardly more than noise."""
    middle, reach = centres.mean(axis=0), np.ptp(centres, axis=0).max()

    def base(points: Floats) -> Floats:
        x, y = np.moveaxis((points - middle) / reach, -1, 0)
        return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=-1)

    if len(centres) < _FEWEST_BENT:
        return np.zeros_like
    design = base(centres)
    factors, kept = fit_without_outliers(design, left)
    fitted = design[kept] @ factors
    bent, noise = (float(2.0 * np.mean(one**2)) for one in (fitted, fitted - left[kept]))
    chance = noise * design.shape[1] * WINDOW_OVERLAP / kept.sum()
    if bent < max(_BENT_PX**2, 9.0 * chance):
        return np.zeros_like
    return lambda points: base(points) @ factors


def fit_without_outliers(base: Floats, places: Floats) -> tuple[Floats, Bools]:
    """Factors (f, 2) of base functions (n, f) that fit places (n, 2) by least squares, and which
    places are no outliers, (n,)."""
    kept = np.ones(len(base), np.bool_)
    for _ in range(5):
        fit = np.linalg.lstsq(base[kept], places[kept], rcond=None)[0]
        off = np.hypot(*(base @ fit - places).T)
        spread = 1.4826 * float(np.median(off[kept]))
        kept = off <= max(3.0 * spread, 0.1)
        if kept.sum() < FEWEST:
            kept[:] = True
            break
    return np.asarray(fit, np.float64), kept


def find_coherent_windows(centres: Floats, off: Floats, spacing_px: float) -> Bools:
    """Which windows (n,) lie as far off as the median of those beside them."""
    kept = np.zeros(len(off), np.bool_)
    for number, centre in enumerate(centres):
        apart = np.abs(centres - centre).max(axis=1)
        beside = off[(apart > 0.0) & (apart < 1.5 * spacing_px)]
        if len(beside) >= 3:
            kept[number] = np.hypot(*(off[number] - np.median(beside, axis=0))) < _COHERENT_PX
    return kept


def fit_most_windows(
    centres: Floats, places: Floats, reach_px: float
) -> tuple[AffineMap | None, Bools]:
    """The affine map that most windows agree on, and which windows these are."""
    count = len(centres)
    if count < FEWEST:
        return None, np.zeros(count, np.bool_)
    random = np.random.default_rng(0)
    tolerance = max(0.15 * reach_px, 1.5)
    ones = np.concatenate([centres, np.ones((count, 1))], axis=1)
    best = np.zeros(count, np.bool_)
    for _ in range(150):
        some = random.choice(count, 3, replace=False)
        if abs(np.linalg.det(ones[some])) < 1.0:
            continue
        made = np.linalg.solve(ones[some], places[some])
        agree = np.hypot(*(ones @ made - places).T) < tolerance
        if agree.sum() > best.sum():
            best = agree
    for _ in range(4):
        if best.sum() < FEWEST:
            return None, best
        made = np.linalg.lstsq(ones[best], places[best], rcond=None)[0]
        best = np.hypot(*(ones @ made - places).T) < tolerance
    return AffineMap(made[:2].T.copy(), made[2].copy()), best
