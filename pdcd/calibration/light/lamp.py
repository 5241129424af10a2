"""Whether the projector's light is constant over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.photo import check_brightness
from pdcd.errors import CalibrationError

_LEAST_PHOTOS = 5
_FLICKER_LIMITS = (0.005, 0.03)
_DRIFT_LIMITS = (0.03, 0.15)
"""Relative, per hour."""


@dataclass(frozen=True)
class Lamp:
    """drift_per_h : relative change in an hour, and its standard deviation. flicker : relative
    standard deviation from photo to photo, beyond noise and drift, and its standard deviation.
    seconds : length of the series."""

    drift_per_h: float
    drift_sigma: float
    flicker: float
    flicker_sigma: float
    seconds: float

    def figures(self) -> tuple[MeasuredFigure, ...]:
        """The figures of the lamp."""
        drift, flicker = _DRIFT_LIMITS[0], _FLICKER_LIMITS[0]
        sure = abs(self.drift_per_h) - 2.0 * self.drift_sigma > drift
        return (
            MeasuredFigure(
                "light.lamp_drift",
                self.drift_per_h,
                self.drift_sigma,
                "1/h",
                f"within {drift:g}",
                Verdict.DOUBTFUL if sure else Verdict.GOOD,
            ),
            MeasuredFigure(
                "light.lamp_flicker",
                self.flicker,
                self.flicker_sigma,
                "",
                f"{flicker:g} or less",
                Verdict.GOOD if self.flicker <= flicker else Verdict.DOUBTFUL,
            ),
        )


def measure_lamp(times_s: Floats, levels: Floats, noise: float = 0.0) -> Lamp:
    """Drift and flicker out of photos of the same white picture.

    Parameters
    ----------
    times_s : (n,) when each was taken, five or more.
    levels : (n,) mean light of the same part of each.
    noise : relative standard deviation of a level by photon noise.

    Raises CalibrationError: too few photos, a dark one, a lamp whose light is not constant.
    """
    times_s, levels = np.asarray(times_s, np.float64), np.asarray(levels, np.float64)
    if levels.size < _LEAST_PHOTOS or np.ptp(times_s) <= 0.0:
        raise CalibrationError(
            f"{levels.size} photos are too few to tell a lamp's drift",
            device="projector",
            hint=f"take {_LEAST_PHOTOS} or more, one after the other",
        )
    middle = float(np.median(levels))
    check_brightness(
        {f"{n + 1} of the series": float(v) for n, v in enumerate(levels)}, 0.3 * middle
    )
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
    if flicker > _FLICKER_LIMITS[1] or abs(change) > _DRIFT_LIMITS[1]:
        raise CalibrationError(
            f"the lamp is unstable: it flickers by {100.0 * flicker:.2g} % and changed by "
            f"{100.0 * change:+.2g} % in {lamp.seconds:.0f} s",
            device="projector",
            hint="let it warm up for half an hour; switch eco mode and automatic iris off; show "
            "each photo for a second or longer",
        )
    return lamp
