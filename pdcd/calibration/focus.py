"""Focus: how deep fine stripes are in a photo, over the field; the best place out of a few.

Defocus by z - z0 blurs by a width that grows in proportion, so that stripes of period P keep

    ln M = const - 2 pi^2 k^2 (z - z0)^2 / P^2,

a parabola: with a few steps about the best one its top is told to a few hundredths of a step.

Which stripes are shown says what is focused: the mask's alone, the camera on the mask (the relay);
the projector's alone, the projector on the scene, or the scene on a diffuser at the mask; both
panels' together, what counts in the end (`pdcd.calibration.registration.Series.modulation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.photo import Photo
from pdcd.calibration.registration import GREEN
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
FEWEST = 3
"""Photos that a parabola takes."""


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


def depth(photo: Photo, axis: int, period_quads: float, *, channel: int = GREEN) -> Depth:
    """Depth of stripes in one photo, wherever they lie, of a period that is known within 15 %.

    axis : 0 for upright stripes in the photo, 1 for lying ones; a tilt by some degrees is allowed.

    Raises CalibrationError for a photo without light, saturated, or without stripes.
    """
    seen, noise = photo.light[..., channel], photo.variance[..., channel]
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


@dataclass(frozen=True)
class Best:
    """What a user who turns a ring wants to see: the number now, and the best so far."""

    now: float = 0.0
    best: float = 0.0

    def then(self, number: float) -> Best:
        """After one more photo."""
        return Best(number, max(self.best, number))

    @property
    def share(self) -> float:
        """The number now over the best so far, 0 to 1: how long a bar is."""
        return self.now / self.best if self.best > 0.0 else 0.0


@dataclass(frozen=True)
class Peak:
    """Where focus is best, in the unit of the steps; `width` is one standard deviation of the
    depth's bell curve."""

    place: float
    sigma: float
    width: float


def peak(places: Sequence[float], depths: Sequence[float]) -> Peak:
    """The best place, by a parabola through ln M with weights M.

    places : (n,) where photos were taken, along any ruler. depths : (n,) of their stripes.

    Raises CalibrationError for less than three places, where depth has no peak, and where the best
    lies beyond the places.
    """
    z, m = np.asarray(places, dtype=np.float64), np.asarray(depths, dtype=np.float64)
    if z.size != m.size or np.unique(z).size < FEWEST or not (m > 0.0).all():
        raise CalibrationError(
            f"focus needs {FEWEST} places or more, each with stripes to be seen",
            hint="take photos on both sides of the best one",
        )
    middle, unit = z.mean(), float(np.ptp(z)) / 2.0
    at = (z - middle) / unit
    powers = np.stack([at**2, at, np.ones(at.size)], axis=-1)
    inverse = np.linalg.pinv((powers * m[:, None] ** 2).T @ powers)
    (a, b, _) = inverse @ (powers.T @ (m**2 * np.log(m)))
    top = -b / (2.0 * a) if a < 0.0 else np.inf
    if not abs(top) <= 1.0:
        raise CalibrationError(
            "the stripes are deepest at the end of the range: there is no peak within it",
            hint="go on turning the same way, then take photos on both sides of the best one",
        )
    left = m * (np.log(m) - powers @ (inverse @ (powers.T @ (m**2 * np.log(m)))))
    spread = float((left**2).sum()) / max(1, z.size - 3)
    slope = np.array([b / (2.0 * a * a), -1.0 / (2.0 * a), 0.0])
    sigma = float(np.sqrt(spread * slope @ inverse @ slope))
    return Peak(float(middle + unit * top), unit * sigma, float(unit / np.sqrt(-2.0 * a)))


@dataclass(frozen=True)
class Tilt:
    """How the best place runs over the field, in the unit of the steps.

    right, down : from the left edge to the right one, from the top to the bottom. sigma : of both.
    """

    middle: float
    right: float
    down: float
    sigma: tuple[float, float, float]


def tilt(places: Sequence[float], photos: Sequence[Depth]) -> Tilt:
    """The plane of best focus, out of the depths of a few places, (rows, cols) each.

    Raises CalibrationError as `peak`, and where less than 4 parts of the field have a peak.
    """
    stack = np.stack([each.parts for each in photos])
    rows, cols = stack.shape[1:]
    x, y = np.meshgrid((np.arange(cols) + 0.5) / cols - 0.5, (np.arange(rows) + 0.5) / rows - 0.5)
    found = []
    for row, col in np.ndindex(rows, cols):
        depths = stack[:, row, col]
        try:
            here = peak(places, depths.tolist())
        except CalibrationError:
            continue
        found.append((here.place, x[row, col], y[row, col]))
    if len(found) < 4:
        raise CalibrationError(
            f"{len(found)} parts of the field have a best focus within the range; 4 are needed",
            hint="take photos over a longer range, with light all over the field",
        )
    best, right, down = np.array(found).T
    plane = np.stack([np.ones(best.size), right, down], axis=-1)
    inverse = np.linalg.inv(plane.T @ plane)
    fitted = inverse @ plane.T @ best
    spread = float(((best - plane @ fitted) ** 2).sum()) / max(1, best.size - 3)
    first, second, third = np.sqrt(spread * np.diag(inverse)).tolist()
    middle, to_right, to_bottom = fitted.tolist()
    return Tilt(middle, to_right, to_bottom, (first, second, third))


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
