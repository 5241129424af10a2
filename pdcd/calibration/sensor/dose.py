"""Linearity and saturation by counted refreshes.

A camera's shutter does not dose light exactly. Refreshes do: n white refreshes inside an open
shutter give n times the light of one, plus what the panel's edges add, ``fall - rise``, which is
the same for every n >= 2. So the signal of a linear sensor is ``a (n + o)``, with o the offset in
refreshes. A straight line is fitted with relative weights over 5 to 95 % of saturation, after EMVA
1288.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.errors import CalibrationError

_LINEAR_SHARES = (0.05, 0.95)
_STOPPED = 0.93
"""Share of the expected light below which the signal has saturated."""
_UNBENT = 0.99
"""Share of the expected light below which some quads have saturated."""
_LEAST_DOSES = 4
_DARK = 0.2
"""Share of the expected light below which a photo is dark."""
_FALLEN = 0.9
"""Share of the light of a smaller dose below which a photo lacks light."""


@dataclass(frozen=True, eq=False)
class DoseLine:
    """How the signal of one plane depends on the dose.

    offset_refreshes, offset_sigma : what the panel's edges add.
    error : largest deviation from the line, over the line; `deviations` all of them, (doses,), NaN
        beyond 5 to 95 %.
    saturation_dn : DN above black at which the signal stops; None where no dose reached it.
    highest_dn : DN above black of the largest dose.
    clipped : whether it stops at one fixed number, as a converter does, or with noise, as a full
        well does.
    """

    offset_refreshes: float
    offset_sigma: float
    error: float
    deviations: Floats
    saturation_dn: float | None
    highest_dn: float
    clipped: bool


def fit_dose_line(
    plane: str, doses: Floats, signal: Floats, full_dn: float, base_dn: float, noise_dn: float
) -> DoseLine:
    """Fit the line of one plane.

    Parameters
    ----------
    plane : its name, for error messages.
    doses : (n,) white refreshes, ascending; equal ones may repeat.
    signal : (n,) DN above black and above the light of no dose, of the brightest quads.
    full_dn, base_dn : DN above black of their median block in the largest dose, and without a dose.
    noise_dn : standard deviation of their samples in the largest dose.

    Raises CalibrationError: fewer than four doses in range, a photo without its light, a signal
    that does not rise.
    """
    top = float(signal.max())
    low = (signal > 0.02 * top) & (signal < 0.5 * top)
    if np.unique(doses[low]).size < 2:
        raise _few(plane, int(low.sum()))
    slope = float(np.ptp(signal[low]) / np.ptp(doses[low]))
    _refuse_missing(plane, doses, signal, slope)
    last, due = full_dn - base_dn, slope * float(doses[-1])
    stopped = last < _STOPPED * due
    highest = last if last < _UNBENT * due else top / _LINEAR_SHARES[1]
    used = (signal >= _LINEAR_SHARES[0] * highest) & (signal <= _LINEAR_SHARES[1] * highest)
    if used.sum() < _LEAST_DOSES:
        raise _few(plane, int(used.sum()))
    columns = np.stack([doses, np.ones_like(doses)], axis=1)[used] / signal[used, None]
    fit, *_ = np.linalg.lstsq(columns, np.ones(int(used.sum())), rcond=None)
    deviations = np.full(doses.shape, np.nan)
    deviations[used] = signal[used] / (fit[0] * doses[used] + fit[1]) - 1.0
    scatter = float(np.sum(deviations[used] ** 2)) / max(int(used.sum()) - 2, 1)
    covariance = scatter * np.linalg.inv(columns.T @ columns)
    return DoseLine(
        offset_refreshes=float(fit[1] / fit[0]),
        offset_sigma=float(np.sqrt(covariance[1, 1]) / fit[0]),
        error=float(np.abs(deviations[used]).max()),
        deviations=deviations,
        saturation_dn=full_dn if stopped else None,
        highest_dn=full_dn,
        clipped=stopped and noise_dn < 1.0,
    )


def _refuse_missing(plane: str, doses: Floats, signal: Floats, slope: float) -> None:
    """Raise CalibrationError for a dose without its light: far less than the slope predicts (such a
    dose lowers the slope itself), or less than a smaller dose gave."""
    top = float(signal.max())
    for dose, seen in zip(doses, signal, strict=True):
        smaller = float(signal[doses < dose].max(initial=0.0))
        due = max(min(slope * dose, top), smaller)
        if seen < max(_DARK * due, _FALLEN * smaller):
            raise CalibrationError(
                f"plane {plane}: the photo of {dose:.0f} refreshes lacks light, {seen:.3g} DN of "
                f"{due:.3g}: the shutter did not open, or not for all of them",
                device="shutter",
                hint="check the shutter's lag and its cable, and repeat the step",
            )


def _few(plane: str, count: int) -> CalibrationError:
    return CalibrationError(
        f"plane {plane}: only {count} doses lie where the sensor is linear",
        device="camera",
        hint="set the aperture so that the middle of the series lies at half of saturation",
    )
