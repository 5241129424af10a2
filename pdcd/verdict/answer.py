"""What the verdict says of an answer as a whole: of its noise, its error bars, light below zero,
and light in it that belongs elsewhere. Pure functions of numbers, as in `pdcd.verdict.quality`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pdcd.arrays import Floats
from pdcd.printable import to_percent
from pdcd.verdict.limits import LIMITS, Grade, VerdictFinding, VerdictLimits, choose_grade

_UPPER = 1.645
"""Standard deviations below which a normal number lies in 19 of 20 cases."""
_FEWEST_CODES = 80
"""Codes of which a pilot and four parts can be made (`pdcd.planning.defaults`)."""
_FREEDOM = 3.0
"""Degrees of freedom of a sigma that the fewest parts have measured."""


def judge_noise(
    image: Floats, sigma: Floats, sensor: Floats, limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Whether the answer stands above its noise; (n, C) each, of pixels in the field.

    The sensor's noise decides, and sigma only where most of the picture drowns in it.
    """
    known = np.isfinite(sigma) & np.isfinite(image)
    if not known.any():
        yield VerdictFinding(
            Grade.BAD,
            "nothing is known of the answer: all of the field is saturated or unseen; close the "
            "aperture and look at what the camera sees",
        )
        return
    rms = float(np.sqrt(np.mean(image[known] ** 2)))
    noise = float(np.sqrt(np.mean(sensor[known] ** 2)))
    share = noise / rms if rms > 0.0 else np.inf
    grade = choose_grade(share, limits.noise)
    if grade:
        yield VerdictFinding(
            grade,
            f"the sensor's noise is {to_percent(share)} of the answer (limit "
            f"{to_percent(limits.noise[0])}); open the aperture, or expose longer",
        )
    unsure = float(np.mean(sigma[known] > rms))
    grade = choose_grade(unsure, limits.unsure)
    if grade:
        yield VerdictFinding(
            grade,
            f"in {to_percent(unsure)} of the field sigma is larger than the answer (limit "
            f"{to_percent(limits.unsure[0])}); take more codes, or parts to measure it",
        )


def judge_error_bars(
    image: Floats, sigma: Floats, sensor: Floats, cells: int, limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """What a measured sigma says of the whole answer; (n, C) each, of pixels in the field of
    `cells` cells.

    The realised square error of few strong pixels scatters about what sigma leads one to expect,
    and sigma itself about its own mean. So the figure is one that is kept in 19 of 20 photos; a
    photo is bad only where sigma as it stands says so. Where the sensor's noise is enough to find
    fault with, `judge_noise` has done so.
    """
    known = np.isfinite(sigma) & np.isfinite(image)
    if not known.any():
        return
    power, squares = float(np.mean(image[known] ** 2)), sigma[known] ** 2
    total = float(np.sum(squares))
    if not total > 0.0:
        return
    # Channels share their paths, and the quads of a cell its codes.
    single = total**2 / float(np.sum(squares**2)) * min(cells / squares.size, 1.0 / 3.0)
    spread = np.sqrt(2.0 / max(single, 1.0) * (1.0 + 1.0 / _FREEDOM))
    mean = float(np.mean(squares))
    share = _of_the_rest(mean * (1.0 + _UPPER * float(spread)), power)
    noise = _of_the_rest(float(np.mean(sensor[known] ** 2)), power)
    least = limits.error[0]
    grade = Grade.DOUBTFUL if share >= least else Grade.REMARK
    grade = max(grade, choose_grade(_of_the_rest(mean, power), limits.error))
    if grade > choose_grade(noise, limits.noise):
        yield VerdictFinding(
            grade,
            f"the answer may be off by {_error(share)} (RMS, limit {to_percent(least)}) "
            "by its error bars: the codes err on sharp light, as of mirrors; take more codes",
        )


def judge_negative_light(
    image: Floats, sensor: Floats, limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Light below zero, in a picture that no path makes darker; (n, C) each, of pixels in the field

    What is below zero is error for certain. Errors go as far up as down, so that of a picture that
    is all error half of the squares are below zero; where there is light, less of it shows. No
    model of the scene is needed.
    """
    known = np.isfinite(sensor) & np.isfinite(image)
    if not known.any():
        return
    power = float(np.mean(image[known] ** 2))
    below = 2.0 * float(np.mean(np.minimum(image[known], 0.0) ** 2))
    noise = float(np.mean(sensor[known] ** 2))
    # Noise is found by itself, and scatters below zero where there is no light.
    share = _of_the_rest(max(below - noise, 0.0), power)
    grade = choose_grade(share, limits.below)
    if grade:
        yield VerdictFinding(
            grade,
            f"the answer has light below zero, which is error: it is off by {_error(share)} or "
            f"more (RMS, limit {to_percent(limits.below[0])}); the codes err on other light, which "
            "is much more than what is wanted; take more codes",
        )


def judge_unmeasured_codes(
    share: float, codes: int, limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Error by codes that nothing has measured. share : RMS over that of the answer if each point
    gets its light by one path, which errs most; of light by many paths it is far less. codes : of
    the photo in all."""
    if share < limits.exact:
        return
    advice = "--parts 4" if codes >= _FEWEST_CODES else f"{_FEWEST_CODES} codes or more"
    yield VerdictFinding(
        Grade.DOUBTFUL if share >= limits.unmeasured else Grade.REMARK,
        f"codes are not in the error bar: on sharp light, as of mirrors, the answer may be off by "
        f"{_error(share)} (RMS, limit {to_percent(limits.unmeasured)}); take {advice}, as four "
        "parts measure it",
    )


def judge_leak(error: float, limits: VerdictLimits = LIMITS) -> Iterator[VerdictFinding]:
    """RMS error by leaks that a dark photo showed, over the RMS of the answer they are in."""
    grade = choose_grade(error, limits.left)
    if grade:
        yield VerdictFinding(
            grade,
            f"ambient light and leaks are {to_percent(error)} of the answer and were not taken off "
            f"(limit {to_percent(limits.left[0])}); darken the room, or take black exposures",
        )


def judge_common_light(share: float, limits: VerdictLimits = LIMITS) -> Iterator[VerdictFinding]:
    """Share of the light of a slice's photos that comes whatever is shown: it is in the picture of
    the scene under all patterns, and not in the entries of T."""
    if share < 1.0 and share / (1.0 - share) < limits.stray[0]:
        return
    yield VerdictFinding(
        Grade.DOUBTFUL,
        f"{to_percent(share)} of the light comes whatever is shown (limit "
        f"{to_percent(limits.stray[0])} of the rest): entries of T are without it, the picture is "
        "not; darken the room",
    )


def judge_pair_sum(
    sums: Floats, floodlit: Floats, variance: Floats, limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Whether a complement pair adds up to the floodlit photo; (n, C) each, of pixels in the field,
    `variance` that of their difference."""
    known = np.isfinite(variance)
    power = float(np.mean(floodlit[known] ** 2)) if known.any() else 0.0
    if not power > 0.0:
        return
    apart = float(np.mean((sums - floodlit)[known] ** 2 - variance[known]))
    share = float(np.sqrt(max(apart, 0.0) / power))
    grade = choose_grade(share, limits.pair_sum)
    if grade:
        yield VerdictFinding(
            grade,
            f"the pair of exposures does not add up to the white photo: it is {to_percent(share)} "
            f"off (limit {to_percent(limits.pair_sum[0])}); look at ambient light and leaks "
            "(black_level), a lamp that drifts, an aperture that does not come back, or a missed "
            "refresh",
        )


def _of_the_rest(error: float, power: float) -> float:
    """RMS error over the RMS of what a picture has without it; both are mean squares."""
    return float(np.sqrt(error / (power - error))) if error < power else np.inf


def _error(share: float) -> str:
    return to_percent(share) if np.isfinite(share) else "as much as all that it shows"
