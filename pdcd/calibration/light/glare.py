"""Veiling glare: light that open parts of the mask spread over its closed ones.

A chequered mask before a white projector. All light comes through the mask, so that the photo over
WW is what the mask lets through, glare included: 1 in open cells, eps and the glare in closed ones.
The glare depends on the picture and is therefore no part of a contrast; it is told of apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.light.contrasts import Share
from pdcd.calibration.light.light_plan import LightPlan
from pdcd.calibration.photo import Photo, refuse_clipped, steady
from pdcd.calibration.shown import Shown
from pdcd.errors import CalibrationError
from pdcd.panels.frames import BLACK, WHITE

Floats = NDArray[np.float64]

CELL_PX = 100
"""Pixels of the mask along a cell: far wider than any blur."""
EDGE_SIGMAS = 4.0
"""Of the blur of edges: so far from an edge a cell is itself."""
LEAST_EDGE, MOST_EDGE = 4, 40
LIT = 0.1
LEAST_SHARE = 0.05
"""Of the lit picture: open, and closed cells without their edges."""
GOOD = 0.002
BAD = 0.02


def glare_photo(size_px: tuple[int, int], plan: LightPlan) -> Shown:
    """The chequered mask, exposed as WW. size_px of the mask is (width, height)."""
    width, height = size_px
    x, y = (np.arange(n) // CELL_PX for n in (width, height))
    chequered = (x[None, :] + y[:, None]) % 2 == 0
    light = np.full(plan.refreshes + 2 * plan.lead, BLACK, np.int32)
    light[plan.lead : -plan.lead] = WHITE
    return Shown(
        "glare", np.zeros((0, 0, 0), np.bool_), chequered[None], light, np.zeros_like(light)
    )


@dataclass(frozen=True)
class Glare:
    """share : light of closed cells over that of open ones, beyond the mask's leak, with half of
    the mask open. worst : the 95th percentile over the picture."""

    share: float
    sigma: float
    worst: float

    def figures(self) -> tuple[Figure, ...]:
        """What to tell of it."""
        verdict = Verdict.GOOD if self.share <= GOOD else Verdict.DOUBTFUL
        if self.share > BAD:
            verdict = Verdict.BAD
        return (
            Figure("light.glare", self.share, self.sigma, "", f"{GOOD:g} or less", verdict),
            Figure("light.glare_worst", self.worst, self.sigma, ""),
        )


def glare_of(white: Photo, chequered: Photo, mask: Share, black_sigma: float = 0.3) -> Glare:
    """Glare with half of the mask open.

    Parameters
    ----------
    white, chequered : WW and the photo of `glare_photo`, of the same exposure.
    mask : its leak.
    black_sigma : standard deviation of a photo's black level, in units of the photos.

    Raises CalibrationError: saturated, or no chequered pattern to be seen.
    """
    for name, photo in (("WW", white), ("glare", chequered)):
        refuse_clipped(name, photo, "close the aperture, or show fewer refreshes")
    whole, part = white.light.sum(axis=2), chequered.light.sum(axis=2)
    lit = whole > LIT * float(np.quantile(whole, 0.98))
    ratio = part / np.where(lit, whole, 1.0)
    closed, opened = lit & (ratio < 0.5), lit & (ratio > 0.5)
    reach = _reach(lit, closed, ratio)
    closed, opened = (binary_erosion(cells, iterations=reach) for cells in (closed, opened))
    least = LEAST_SHARE * float(lit.sum())
    if closed.sum() < least or opened.sum() < least or np.median(ratio[opened]) < 0.8:
        raise CalibrationError(
            "the mask does not show a chequered pattern, or it is out of focus",
            device="mask",
            hint="see that the mask gets its picture, that outputs are not swapped, and that the "
            "camera is focused on the mask",
        )
    kept = closed.copy()
    kept[closed] = steady(ratio[closed])
    # A ratio of sums: a mean of ratios would weigh dark corners as much as the middle.
    share = float(part[kept].sum() / whole[kept].sum()) - mask.value
    level = float(whole[kept].mean())
    noise = float(np.sqrt(chequered.variance[kept].sum())) / float(whole[kept].sum())
    sigma = float(np.hypot(np.hypot(3.0 * black_sigma / level, mask.sigma), noise))
    return Glare(share, sigma, float(np.quantile(ratio[kept], 0.95)) - mask.value)


def _reach(lit: NDArray[np.bool_], closed: NDArray[np.bool_], ratio: Floats) -> int:
    """Quads beside an edge that see it, from the width over which light goes from 16 to 84 %: two
    standard deviations of the blur."""
    between = int((lit & (ratio > 0.16) & (ratio < 0.84)).sum())
    edge = int((closed & ~binary_erosion(closed)).sum())
    sigma = 0.5 * between / max(edge, 1)
    return int(np.clip(np.ceil(EDGE_SIGMAS * sigma) + 1, LEAST_EDGE, MOST_EDGE))
