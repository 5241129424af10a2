"""To what angle a polariser is to be turned.

A polariser at the angle th passes ``I = m + c cos 2th + s sin 2th``. Some photos of white and of
black, at angles known, tell both curves; a polariser is set by the least light of black, which is
the sharper one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.figures import Figure, Verdict
from pdcd.errors import CalibrationError

Floats = NDArray[np.float64]

LEAST_ANGLES = 5
"""Three numbers, and two more to see whether the law holds."""
SEEN_SIGMAS = 5.0
MISFIT = 0.05
"""Of the curve's height: a polariser that follows its law stays below."""
CHANNELS_DEG = 5.0
"""R, G and B of one polarisation have their least light within that."""


@dataclass(frozen=True)
class Curve:
    """One curve: mean, height (half of highest less least), angle of least light in degrees
    0..180, and the standard deviations of height and angle; `misfit` is relative to the height."""

    mean: float
    height: float
    height_sigma: float
    least_deg: float
    least_sigma_deg: float
    misfit: float

    def at(self, angle_deg: float) -> float:
        """Light at an angle."""
        return self.mean - self.height * float(np.cos(2.0 * np.radians(angle_deg - self.least_deg)))


@dataclass(frozen=True)
class Polariser:
    """The angle of least light of black, how far to turn to it (-90..90), the contrasts now and
    there, and how far R, G and B are apart in degrees."""

    angle_deg: float
    sigma_deg: float
    turn_deg: float
    contrast_now: float
    contrast_then: float
    channels_deg: float

    def figures(self) -> tuple[Figure, ...]:
        """What to tell of it."""
        near = abs(self.turn_deg) <= max(0.5, 2.0 * self.sigma_deg)
        same = self.channels_deg <= CHANNELS_DEG
        return (
            Figure(
                "light.polariser_turn",
                self.turn_deg,
                self.sigma_deg,
                "deg",
                "within 0.5",
                Verdict.GOOD if near else Verdict.DOUBTFUL,
            ),
            Figure(
                "light.polariser_colours",
                self.channels_deg,
                self.sigma_deg,
                "deg",
                f"{CHANNELS_DEG:g} or less",
                Verdict.GOOD if same else Verdict.DOUBTFUL,
            ),
        )


def curve_of(angles_deg: Floats, levels: Floats) -> Curve:
    """Fit one curve; linear in m, c, s. angles_deg, levels : (n,), five angles or more.

    Raises CalibrationError: too few angles, or light that does not change with them.
    """
    angles = np.radians(np.asarray(angles_deg, np.float64))
    levels = np.asarray(levels, np.float64)
    if np.unique(np.round(np.degrees(angles) % 180.0, 1)).size < LEAST_ANGLES:
        raise CalibrationError(
            f"fewer than {LEAST_ANGLES} angles of the polariser",
            device="mask",
            hint="turn it by 30 degrees from photo to photo, six times",
        )
    columns = np.stack([np.ones_like(angles), np.cos(2 * angles), np.sin(2 * angles)], axis=1)
    normal = columns.T @ columns
    if np.linalg.cond(normal) > 100.0:
        raise CalibrationError(
            "the angles of the polariser lie too close together",
            device="mask",
            hint="spread them over half a turn: 0, 30, 60, 90, 120, 150 degrees",
        )
    mean, c, s = np.linalg.solve(normal, columns.T @ levels)
    left = levels - columns @ np.array([mean, c, s])
    spread = float(np.sum(left**2)) / (levels.size - 3)
    covariance = spread * np.linalg.inv(normal)
    height = float(np.hypot(c, s))
    across = np.array([0.0, c, s]) / max(height, 1e-300)
    along = np.array([0.0, -s, c]) / max(height, 1e-300)
    height_sigma = float(np.sqrt(across @ covariance @ across))
    if height <= SEEN_SIGMAS * height_sigma or height <= 0.01 * abs(mean):
        raise CalibrationError(
            "light does not change with the angle of the polariser",
            device="mask",
            hint="see that the polariser was turned, that it is the one at the mask, and that the "
            "light is not saturated",
        )
    least = 0.5 * float(np.arctan2(s, c)) + 0.5 * np.pi
    return Curve(
        mean=float(mean),
        height=height,
        height_sigma=height_sigma,
        least_deg=float(np.degrees(least) % 180.0),
        least_sigma_deg=float(np.degrees(0.5 * np.sqrt(along @ covariance @ along) / height)),
        misfit=float(np.abs(left).max() / height),
    )


def polariser_of(angles_deg: Floats, black: Floats, white: Floats, now_deg: float) -> Polariser:
    """Where to turn the polariser to.

    Parameters
    ----------
    angles_deg : (n,) at which photos were taken, six of them over half a turn.
    black, white : (n, 3) mean light of each with the mask black and white, equal exposures; what
        the room and the sensor's black add is taken off.
    now_deg : where it stands.

    Raises CalibrationError: see `curve_of`; also where the light does not follow the law.
    """
    black, white = np.asarray(black, np.float64), np.asarray(white, np.float64)
    whole = curve_of(angles_deg, black.mean(axis=1))
    if whole.misfit > MISFIT:
        raise CalibrationError(
            f"light does not follow a polariser's law: it is off by {100.0 * whole.misfit:.0f} %",
            device="mask",
            hint="read the angles again; keep lamp and room constant, and nothing saturated",
        )
    bright = curve_of(angles_deg, white.mean(axis=1))
    colours = [curve_of(angles_deg, black[:, c]).least_deg for c in range(3)]
    apart = [_between(colours[i], colours[j]) for i, j in ((0, 1), (0, 2), (1, 2))]
    return Polariser(
        angle_deg=whole.least_deg,
        sigma_deg=whole.least_sigma_deg,
        turn_deg=_between(whole.least_deg, now_deg),
        contrast_now=_contrast(bright, whole, now_deg),
        contrast_then=_contrast(bright, whole, whole.least_deg),
        channels_deg=max(abs(a) for a in apart),
    )


def _between(to_deg: float, from_deg: float) -> float:
    """Shortest turn, -90..90: a polariser is the same after half a turn."""
    return (to_deg - from_deg + 90.0) % 180.0 - 90.0


def _contrast(white: Curve, black: Curve, angle_deg: float) -> float:
    """White over black, of which no less is seen than its error."""
    return white.at(angle_deg) / max(black.at(angle_deg), black.height_sigma, 1e-9)
