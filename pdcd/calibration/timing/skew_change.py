"""By how much the mask's lag has changed, from the timing strips of then and of now.

A photo of strips gives one number for each pulse programme: light over white. What the lag does to
them is known from a model of both panels' response (times and contrasts as calibrated); compared
with the photo of the calibration itself, all else that the model gets wrong drops out:

    now_k = (1 + a) (then_k + model_k(s) - model_k(s_then)).

The factor 1 + a takes what lamp and exposure did to all strips.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import CalibrationError

Floats = NDArray[np.float64]

STEP_S = 0.5e-3
"""How finely the change is first looked for."""
NEAR_S = 0.02e-3
"""Half the way over which the model's slope is taken."""
LEAST_LIGHT = 1e-3
"""Largest strip over white, below which no strip was lit."""
FITS = 5.0
"""Residual, over noise, of strips that no lag explains."""
MODEL = 0.004
"""Error of the model's changes from lag to lag, over white, where times are known to 5 %."""


def skew_change(
    now: Floats,
    then: Floats,
    sigma: Floats,
    model: Callable[[float], Floats],
    skew_then_s: float,
    refresh_s: float,
) -> tuple[float, float]:
    """Change of the lag in s, and its standard deviation.

    now, then : (K,) light of the strips over white. sigma : (K,) of their difference.
    model : from a lag in s to what the strips give, (K,), with the calibrated times.
    skew_then_s : the calibrated lag.

    Changes of up to two and a half refreshes are found. Raises CalibrationError for dark strips,
    and for strips that no lag explains.
    """
    if not max(float(now.max()), 0.0) > LEAST_LIGHT:
        raise CalibrationError(
            "the timing strips are black",
            device="display",
            hint="look whether both panels show their strips",
        )
    base = model(skew_then_s)

    def left(change_s: float) -> tuple[Floats, Floats]:
        """What is left of the strips, in standard deviations, and the factor's direction."""
        expected = then + model(skew_then_s + change_s) - base
        factor = float((now * expected / sigma**2).sum() / (expected**2 / sigma**2).sum())
        return (now - factor * expected) / sigma, expected / sigma

    reach = 2.5 * refresh_s
    changes = np.arange(-reach, reach + STEP_S, STEP_S)
    best = float(changes[int(np.argmin([(left(each)[0] ** 2).sum() for each in changes]))])
    for _ in range(6):
        rest, along = left(best)
        slope = (left(best + NEAR_S)[0] - left(best - NEAR_S)[0]) / (2.0 * NEAR_S)
        slope = slope - along * float(slope @ along / (along @ along))
        step = -float(slope @ rest / (slope @ slope))
        best += float(np.clip(step, -STEP_S, STEP_S))
    rest, _ = left(best)
    # The further the lag moved, the more the model's own errors count.
    allowed = np.sqrt(1.0 + (MODEL * min(1.0, abs(best) / refresh_s * 8.0) / sigma) ** 2)
    chi = float(np.sqrt(np.mean((rest / allowed) ** 2)))
    if chi > FITS:
        raise CalibrationError(
            f"no lag explains the timing strips ({chi:.0f} times their noise)",
            device="display",
            hint="calibrate the timing anew",
        )
    return best, max(1.0, chi) / float(np.sqrt(slope @ slope))
