"""Focus: how deep fine stripes are in a photo, over the field.

Which stripes are shown says what is focused: the mask's alone, the camera on the mask (the relay);
the projector's alone, the projector on the scene, or the scene on a diffuser at the mask; both
panels' together, what counts in the end (`registration.offsets.Series.modulation`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.photo import Photo
from pdcd.calibration.registration.offsets import GREEN
from pdcd.errors import CalibrationError

Floats = NDArray[np.float64]

PARTS = (3, 4)
"""Rows and columns of the field in which the depth is told apart."""
LEAST_DEPTH = 0.02
"""Depth of stripes, over the mean light, below which there are none."""
SURE = 6.0
"""How far above noise and texture the stripes must stand, in standard deviations."""
LEAST_PERIODS = 6
"""Periods across a part of the field that are looked at together."""


@dataclass(frozen=True, eq=False)
class Depth:
    """How deep stripes are: amplitude over mean light, 0 to about 1.27 of sharp ones.

    parts, sigma : (rows, cols) over the photo; NaN where no light is.
    """

    parts: Floats
    sigma: Floats

    @property
    def number(self) -> float:
        """The one number to be made as large as it can be: the mean over the field."""
        return float(np.nanmean(self.parts))

    @property
    def number_sigma(self) -> float:
        """Its standard deviation."""
        seen = self.sigma[np.isfinite(self.parts)]
        return float(np.sqrt(np.sum(seen**2)) / seen.size)

    @property
    def slope(self) -> tuple[float, float]:
        """How ln M grows from the left edge to the right one, and from the top to the bottom:
        large where the plane of focus is tilted. NaN where a part of the field is dark."""
        rows, cols = self.parts.shape
        x, y = (np.arange(cols) + 0.5) / cols - 0.5, (np.arange(rows) + 0.5) / rows - 0.5
        logs = np.log(np.maximum(self.parts, 1e-6))
        return (
            float((logs * x).sum() / (rows * (x**2).sum())),
            float((logs * y[:, None]).sum() / (cols * (y**2).sum())),
        )


def depth(photo: Photo, axis: int, period_quads: float) -> Depth:
    """Depth of stripes in one photo, wherever they lie, of a period that is known within 15 %.

    axis : 0 for upright stripes in the photo, 1 for lying ones; a tilt by some degrees is allowed.

    Raises CalibrationError for a photo without light, saturated, or without stripes.
    """
    seen, noise = photo.light[..., GREEN], photo.variance[..., GREEN]
    if not np.mean(seen) > 5.0 * np.sqrt(np.mean(noise) / seen.size) or not np.mean(seen) > 0.0:
        raise CalibrationError(
            "there is no light in the photo",
            device="camera",
            hint="take the lens cap off, switch the lamp on, and look whether the shutter opens",
        )
    if photo.saturated is not None and np.mean(photo.saturated) > 0.001:
        raise CalibrationError(
            "the photo is saturated", device="camera", hint="expose less, or lower the ISO"
        )
    rows, cols = PARTS
    parts, sigma = np.full(PARTS, np.nan), np.full(PARTS, np.nan)
    height, width = seen.shape[0] // rows, seen.shape[1] // cols
    across = (width, height)[axis]
    if across < LEAST_PERIODS * period_quads:
        raise ValueError(f"{across} quads a part hold less than {LEAST_PERIODS} periods")
    means = np.array([[seen[_part(r, c, height, width)].mean() for c in range(cols)]
                      for r in range(rows)])  # fmt: skip
    for row, col in np.argwhere(means > 0.1 * means.max()):
        part = _part(row, col, height, width)
        turned = (seen[part], noise[part]) if axis == 0 else (seen[part].T, noise[part].T)
        parts[row, col], sigma[row, col] = _depth(*turned, period_quads)
    found = Depth(parts, sigma)
    if not found.number > max(LEAST_DEPTH, SURE * found.number_sigma):
        raise CalibrationError(
            f"no stripes of {period_quads:.1f} quads are seen: their depth is {found.number:.3f}",
            device="camera",
            hint="look whether the panel shows stripes, then turn the focus through its range",
        )
    return found


def _part(row: int, col: int, height: int, width: int) -> tuple[slice, slice]:
    return slice(row * height, (row + 1) * height), slice(col * width, (col + 1) * width)


def _depth(light: Floats, variance: Floats, period: float) -> tuple[float, float]:
    """Depth of upright stripes in a part of a photo, and its standard deviation.

    A window that falls off to the edges keeps light of the mean and of other periods away; the
    highest of finely spaced frequencies near the one that is wanted is the stripes'.
    """
    height, width = light.shape
    window = np.outer(np.hanning(height + 2)[1:-1], np.hanning(width + 2)[1:-1])
    window /= window.sum()
    mean = float((window * light).sum())
    centred = window * (light - mean)
    right = np.linspace(0.85, 1.15, 31) / period
    # Tilts of up to 10 degrees.
    down = np.linspace(-0.17, 0.17, 25) / period
    across = np.exp(2j * np.pi * np.arange(width)[:, None] * right)
    along = np.exp(2j * np.pi * np.arange(height)[:, None] * down)
    power = np.abs(along.T @ centred @ across)
    # Noise, whatever its kind, is as strong a little beside: there, no harmonic of stripes falls.
    beside = np.exp(
        2j * np.pi * np.arange(width)[:, None] * np.array([0.6, 0.7, 1.4, 1.6]) / period
    )
    floor = float(np.sqrt(np.mean(np.abs(along.T @ centred @ beside) ** 2)))
    shot = float(np.sqrt((window**2 * variance).sum()))
    best = 2.0 * float(power.max()) / mean
    return best, 2.0 * max(shot, floor) / mean
