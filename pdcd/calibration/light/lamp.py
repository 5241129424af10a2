"""Whether the projector's light stays what it is: over time, and whatever the picture shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.photo import Photo, refuse_clipped, refuse_dark
from pdcd.calibration.shown import Shown, still
from pdcd.errors import CalibrationError
from pdcd.panels.frames import WHITE

Floats = NDArray[np.float64]
Marks = NDArray[np.bool_]

LEAST_PHOTOS = 5
FLICKER_LIMITS = (0.005, 0.03)
DRIFT_LIMITS = (0.03, 0.15)
"""Of an hour."""
IRIS_LIMITS = (0.005, 0.03)
"""Good up to the first; beyond the second there is no calibration."""
PATCH_SHARE = 0.05
"""Of the picture: the patch, and what stays black about it in the bright picture."""
EDGE_QUADS = 3


@dataclass(frozen=True)
class Lamp:
    """drift_per_h : relative change in an hour, and its standard deviation. flicker : relative
    standard deviation from photo to photo, beyond noise and drift, and its own one. seconds : of
    the series."""

    drift_per_h: float
    drift_sigma: float
    flicker: float
    flicker_sigma: float
    seconds: float

    def figures(self) -> tuple[Figure, ...]:
        """What to tell of it."""
        drift, flicker = DRIFT_LIMITS[0], FLICKER_LIMITS[0]
        sure = abs(self.drift_per_h) - 2.0 * self.drift_sigma > drift
        return (
            Figure(
                "light.lamp_drift",
                self.drift_per_h,
                self.drift_sigma,
                "1/h",
                f"within {drift:g}",
                Verdict.DOUBTFUL if sure else Verdict.GOOD,
            ),
            Figure(
                "light.lamp_flicker",
                self.flicker,
                self.flicker_sigma,
                "",
                f"{flicker:g} or less",
                Verdict.GOOD if self.flicker <= flicker else Verdict.DOUBTFUL,
            ),
        )


def lamp_of(times_s: Floats, levels: Floats, noise: float = 0.0) -> Lamp:
    """Drift and flicker out of photos of the same white picture.

    Parameters
    ----------
    times_s : (n,) when each was taken, five or more.
    levels : (n,) mean light of the same part of each.
    noise : relative standard deviation of a level by photon noise.

    Raises CalibrationError: too few photos, a dark one, a lamp that is no constant light.
    """
    times_s, levels = np.asarray(times_s, np.float64), np.asarray(levels, np.float64)
    if levels.size < LEAST_PHOTOS or np.ptp(times_s) <= 0.0:
        raise CalibrationError(
            f"{levels.size} photos do not tell a lamp's drift",
            device="projector",
            hint=f"take {LEAST_PHOTOS} or more, one after the other",
        )
    middle = float(np.median(levels))
    refuse_dark({f"{n + 1} of the series": float(v) for n, v in enumerate(levels)}, 0.3 * middle)
    relative = levels / middle
    at = times_s - times_s.mean()
    slope = float(at @ (relative - relative.mean()) / (at @ at))
    left = relative - relative.mean() - slope * at
    spread = float(np.sum(left**2)) / (levels.size - 2)
    flicker = float(np.sqrt(max(spread - noise**2, 0.0)))
    lamp = Lamp(
        drift_per_h=3600.0 * slope,
        drift_sigma=3600.0 * float(np.sqrt(max(spread, noise**2) / (at @ at))),
        flicker=flicker,
        flicker_sigma=float(np.sqrt(spread / (2.0 * (levels.size - 2)))),
        seconds=float(np.ptp(times_s)),
    )
    change = slope * lamp.seconds
    if flicker > FLICKER_LIMITS[1] or abs(change) > DRIFT_LIMITS[1]:
        raise CalibrationError(
            f"the lamp is unstable: it flickers by {100.0 * flicker:.2g} % and changed by "
            f"{100.0 * change:+.2g} % in {lamp.seconds:.0f} s",
            device="projector",
            hint="let it warm up for half an hour; switch eco mode and automatic iris off; show "
            "each photo for a second or longer",
        )
    return lamp


def iris_photos(size_px: tuple[int, int], refreshes: int) -> tuple[Shown, Shown]:
    """A white patch in the middle of the projector's picture: alone (5 % of it is white), and in a
    white picture, a black frame about it (95 %). size_px is (width, height)."""
    width, height = size_px
    x, y = ((np.arange(n) + 0.5) / n - 0.5 for n in (width, height))
    away = np.maximum(np.abs(x)[None, :], np.abs(y)[:, None])
    patch = away <= 0.5 * np.sqrt(PATCH_SHARE)
    frame = ~patch & (away <= 0.5 * np.sqrt(2.0 * PATCH_SHARE))
    return (
        still("iris-dark", refreshes, patch, WHITE),
        still("iris-bright", refreshes, ~frame, WHITE),
    )


@dataclass(frozen=True)
class Iris:
    """change : light of the patch in the bright picture over that in the dark one, less 1."""

    change: float
    sigma: float

    def figures(self) -> tuple[Figure, ...]:
        """What to tell of it."""
        good = abs(self.change) <= IRIS_LIMITS[0] + 2.0 * self.sigma
        verdict = Verdict.GOOD if good else Verdict.DOUBTFUL
        limit = f"within {IRIS_LIMITS[0]:g}"
        return (Figure("light.iris", self.change, self.sigma, "", limit, verdict),)


def iris_of(dark: Photo, bright: Photo) -> Iris:
    """Whether a patch changes with what surrounds it.

    dark, bright : the photos of `iris_photos`, the room's light taken off where there is much.

    Raises CalibrationError: saturated, no patch to be seen, or a patch that changes by over 3 %:
    an automatic iris, dynamic contrast, or glare.
    """
    for name, photo in (("iris-dark", dark), ("iris-bright", bright)):
        refuse_clipped(name, photo, "close the aperture, or show fewer refreshes")
    patch = _patch(dark)
    first, second = (photo.light[patch].mean() for photo in (dark, bright))
    noise = np.sqrt((dark.variance[patch].mean() + bright.variance[patch].mean()) / patch.sum() / 3)
    change = float(second / first - 1.0)
    if abs(change) > IRIS_LIMITS[1]:
        raise CalibrationError(
            f"a white patch changes by {100.0 * change:+.2g} % when the picture about it gets "
            "bright",
            device="projector",
            hint="switch automatic iris, dynamic contrast and eco mode off; see that no bright "
            "surface reflects onto the card",
        )
    return Iris(change, float(noise / first))


def _patch(dark: Photo) -> Marks:
    """Where the patch is seen, its edges left out."""
    light = dark.light.sum(axis=2)
    high, low = float(np.quantile(light, 0.995)), float(np.median(light))
    noise = float(np.sqrt(np.median(dark.variance.sum(axis=2))))
    found = binary_erosion(light > 0.5 * (high + low), iterations=EDGE_QUADS)
    dark_around = high > 3.0 * low and high - low > 8.0 * noise
    if not dark_around or not 0.0 < found.mean() < 0.3:
        raise CalibrationError(
            "no white patch is seen on black",
            device="projector",
            hint="see that camera and projector look at the same place, in focus, the lens cap off",
        )
    return np.asarray(found)
