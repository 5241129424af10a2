"""What can be wrong with photos of strips: each check names the cause, the likeliest first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.figures import ROOM_GOOD, ROOM_MOST, describe_room_light
from pdcd.calibration.timing.strips import StripReadings
from pdcd.calibration.timing.timing_fit import LONGEST_TAU_S, FittedTiming
from pdcd.calibration.timing.timing_model import TAUS
from pdcd.errors import CalibrationError

_MOST_CHI2 = 20.0
"""Largest reduced chi^2 of a fit that is believed at all. Rows that are set in steps, fitted by a
straight line, stay below it; a tail of a tenth gives 90."""
STRAY = 0.1
"""Largest light other than the panels', over white."""
PEAK = 0.02
"""Least light over white at the best delay of the mask, and least difference of strips that
pulse."""
_FAR = 1e3
"""Reduced chi^2 above which strips show other pulses than they should: mirrored, or moved."""
_ASTRAY = "a picture that is mirrored or has moved shows other strips: run geometry"
_SURELY = 0.1
"""Weight above which a cause is reported."""
_CLEARLY = 0.5
"""Share of the residuals that places, or pulses, explain where these are the cause; uneven light
changes pulses to different degrees, and leaves 0.3."""


def measure_room_light(reading: StripReadings) -> float:
    """Light other than the projector's white, over that white: the median of all places. Raises
    CalibrationError where it is too much to measure with."""
    share = float(np.median(reading.room))
    if share > ROOM_MOST:
        raise CalibrationError(
            describe_room_light(share), device="camera", hint="switch the room lights off"
        )
    return share


def explain_misfit(readings: Sequence[StripReadings], found: FittedTiming) -> tuple[str, ...]:
    """Possible reasons why times do not explain the strips, and what to do, the likeliest first.
    The residuals depend on the place of a strip, on its programme, or on neither."""
    left = found.left.mean(axis=1)  # (photos, K)
    kinds = np.array([[f"{p.lit}|{p.opened}" for p in r.programmes] for r in readings])
    places = np.broadcast_to(np.arange(left.shape[1]), left.shape)
    by_place, by_kind = _explained(left, places), _explained(left, kinds)
    room = measure_room_light(readings[0])
    causes = [
        (max(0.0, room / ROOM_GOOD - 0.5), describe_room_light(room)),
        (
            max(0.0, _CLEARLY - by_place - by_kind),
            "the lamp's light must not flicker: switch eco mode, dynamic contrast and an auto iris "
            "off",
        ),
        (by_place, "nothing may move between the photos, and the maps must fit: run geometry"),
        (float(found.chi2 > _FAR), _ASTRAY),
        (
            by_kind,
            "switch off overdrive and frame interpolation: a panel does not rise and fall "
            "as it should",
        ),
    ]
    causes.sort(key=lambda cause: -cause[0])
    return tuple(text for weight, text in causes if weight > _SURELY)


def check_timing_fit(readings: Sequence[StripReadings], found: FittedTiming) -> None:
    """Raise CalibrationError for strips that no times explain, with possible causes."""
    if found.chi2 > _MOST_CHI2:
        raise CalibrationError(
            f"no rise, fall and lag explain the strips (reduced chi^2 {found.chi2:.0f}, at most "
            f"{_MOST_CHI2:g})",
            device="display",
            hint="; ".join(explain_misfit(readings, found)),
        )


def _explained(left: Floats, groups: NDArray[np.generic]) -> float:
    """Share of the variance of `left` that the groups' means explain, beyond what as many groups
    explain by chance; 0 where each value is its own group."""
    _, number, count = np.unique(groups, return_inverse=True, return_counts=True)
    if count.max() == 1 or count.size == 1:
        return 0.0
    mean = np.bincount(number.ravel(), left.ravel()) / count
    share = float(np.sum(count * mean**2) / max(float(np.sum(left**2)), 1e-300))
    by_chance = count.size / left.size
    return float(max(0.0, (share - by_chance) / (1.0 - by_chance)))


def check_panel_speed(found: FittedTiming) -> None:
    """Raise CalibrationError for a panel whose time constant is at the upper bound of the fit."""
    slow = found.times.taus_s > 0.9 * LONGEST_TAU_S
    if slow.any():
        raise CalibrationError(
            f"{TAUS[int(np.argmax(slow))]} is {1e3 * LONGEST_TAU_S:.0f} ms or more",
            device="display",
            hint="that panel does not follow its refreshes: switch off what smooths motion; "
            + _ASTRAY,
        )


def check_reference_strips(readings: Sequence[StripReadings]) -> None:
    """Raise CalibrationError for strips that should be black or white and are not."""
    for reading in readings:
        black = ["1" not in p.lit + p.opened for p in reading.programmes]
        white = ["0" not in p.lit + p.opened for p in reading.programmes]
        if not any(black) or not any(white):
            raise ValueError("programmes without a black and a white one")
        dark = float(np.median(reading.value[:, black]))
        full = float(np.median(reading.value[:, white]))
        pulsing = [not p.still for p in reading.programmes]
        if dark > STRAY * max(full, 1e-12) and full - dark > 0.3:
            raise make_room_light_error(dark / full)
        if not _delays_matter(reading, np.array(pulsing), PEAK * full):
            raise CalibrationError(
                "no strip pulses with its light",
                device="display",
                hint="the panels must show every refresh 1:1; where the mask is many refreshes "
                "late, run the coarse search first",
            )


def _delays_matter(reading: StripReadings, pulsing: NDArray[np.bool_], least: float) -> bool:
    """Whether strips that differ only in the mask's delay differ in their light."""
    level = np.median(reading.value, axis=0)
    kinds = np.array([p.lit + _rhythm(p.opened) for p in reading.programmes])
    spreads = [
        float(np.ptp(level[pulsing & (kinds == kind)])) for kind in np.unique(kinds[pulsing])
    ]
    return max(spreads) > least


def _rhythm(opened: str) -> str:
    """A key that programmes have in common where they differ only in a delay."""
    return min(opened[k:] + opened[:k] for k in range(len(opened)))


def make_room_light_error(share: float) -> CalibrationError:
    """The error for light that bypasses the mask."""
    return CalibrationError(
        f"black strips have {100.0 * share:.0f} % of the light of white ones",
        device="camera",
        hint="switch the room lights off, and cover whatever glares",
    )
