"""What the verdict says of an answer as a whole: of its noise, its error bars, light below zero,
and light in it that belongs elsewhere. Pure functions of numbers, as in `pdcd.verdict.quality`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pdcd.printable import percent
from pdcd.verdict.limits import LIMITS, Finding, Grade, Limits, graded

Floats = NDArray[np.float64]

UPPER = 1.645
"""Standard deviations below which a normal number lies in 19 of 20 cases."""
FEWEST_CODES = 80
"""Codes of which a pilot and four parts can be made (`pdcd.planning.defaults`)."""
FREEDOM = 3.0
"""Degrees of freedom of a sigma that the fewest parts have measured."""


def answer_of(
    image: Floats, sigma: Floats, sensor: Floats, limits: Limits = LIMITS
) -> Iterator[Finding]:
    """Whether the answer stands above its noise; (n, C) each, of pixels in the field.

    The sensor's noise decides, and sigma only where most of the picture drowns in it.
    """
    known = np.isfinite(sigma) & np.isfinite(image)
    if not known.any():
        yield Finding(
            Grade.BAD,
            "nothing is known of the answer: all of the field is saturated or unseen; close the "
            "aperture and look at what the camera sees",
        )
        return
    rms = float(np.sqrt(np.mean(image[known] ** 2)))
    noise = float(np.sqrt(np.mean(sensor[known] ** 2)))
    share = noise / rms if rms > 0.0 else np.inf
    grade = graded(share, limits.noise)
    if grade:
        yield Finding(
            grade,
            f"the sensor's noise is {percent(share)} of the answer (limit "
            f"{percent(limits.noise[0])}); open the aperture, or expose longer",
        )
    unsure = float(np.mean(sigma[known] > rms))
    grade = graded(unsure, limits.unsure)
    if grade:
        yield Finding(
            grade,
            f"in {percent(unsure)} of the field sigma is larger than the answer (limit "
            f"{percent(limits.unsure[0])}); take more codes, or parts to measure it",
        )


def error_of(
    image: Floats, sigma: Floats, sensor: Floats, cells: int, limits: Limits = LIMITS
) -> Iterator[Finding]:
    """What a measured sigma says of the whole answer; (n, C) each, of pixels in the field of
    `cells` cells.

    The realised square error of few strong pixels scatters about what sigma leads one to expect,
    and sigma itself about its own mean. So the figure is one that is kept in 19 of 20 photos; a
    photo is bad only where sigma as it stands says so. Where the sensor's noise is enough to find
    fault with, `answer_of` has done so.
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
    spread = np.sqrt(2.0 / max(single, 1.0) * (1.0 + 1.0 / FREEDOM))
    mean = float(np.mean(squares))
    share = _of_the_rest(mean * (1.0 + UPPER * float(spread)), power)
    noise = _of_the_rest(float(np.mean(sensor[known] ** 2)), power)
    least = limits.error[0]
    grade = Grade.DOUBTFUL if share >= least else Grade.REMARK
    grade = max(grade, graded(_of_the_rest(mean, power), limits.error))
    if grade > graded(noise, limits.noise):
        yield Finding(
            grade,
            f"the answer may be off by {_error(share)} (RMS, limit {percent(least)}) "
            "by its error bars: the codes err on sharp light, as of mirrors; take more codes",
        )


def negative_light(image: Floats, sensor: Floats, limits: Limits = LIMITS) -> Iterator[Finding]:
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
    grade = graded(share, limits.below)
    if grade:
        yield Finding(
            grade,
            f"the answer has light below zero, which is error: it is off by {_error(share)} or "
            f"more (RMS, limit {percent(limits.below[0])}); the codes err on other light, which "
            "is much more than what is wanted; take more codes",
        )


def codes_unknown(share: float, codes: int, limits: Limits = LIMITS) -> Iterator[Finding]:
    """Error by codes that nothing has measured. share : RMS over that of the answer if each point
    gets its light by one path, which errs most; of light by many paths it is far less. codes : of
    the photo in all."""
    if share < limits.exact:
        return
    advice = "--parts 4" if codes >= FEWEST_CODES else f"{FEWEST_CODES} codes or more"
    yield Finding(
        Grade.DOUBTFUL if share >= limits.unmeasured else Grade.REMARK,
        f"codes are not in the error bar: on sharp light, as of mirrors, the answer may be off by "
        f"{_error(share)} (RMS, limit {percent(limits.unmeasured)}); take {advice}, as four parts "
        "measure it",
    )


def leak_left(error: float, limits: Limits = LIMITS) -> Iterator[Finding]:
    """RMS error by leaks that a dark photo showed, over the RMS of the answer they are in."""
    grade = graded(error, limits.left)
    if grade:
        yield Finding(
            grade,
            f"ambient light and leaks are {percent(error)} of the answer and were not taken off "
            f"(limit {percent(limits.left[0])}); darken the room, or take black exposures",
        )


def common_light(share: float, limits: Limits = LIMITS) -> Iterator[Finding]:
    """Share of the light of a slice's photos that comes whatever is shown: it is in the picture of
    the scene under all patterns, and not in the entries of T."""
    if share < 1.0 and share / (1.0 - share) < limits.stray[0]:
        return
    yield Finding(
        Grade.DOUBTFUL,
        f"{percent(share)} of the light comes whatever is shown (limit "
        f"{percent(limits.stray[0])} of the rest): entries of T are without it, the picture is "
        "not; darken the room",
    )


def pair_sum(
    sums: Floats, floodlit: Floats, variance: Floats, limits: Limits = LIMITS
) -> Iterator[Finding]:
    """Whether a complement pair adds up to the floodlit photo; (n, C) each, of pixels in the field,
    `variance` that of their difference."""
    known = np.isfinite(variance)
    power = float(np.mean(floodlit[known] ** 2)) if known.any() else 0.0
    if not power > 0.0:
        return
    apart = float(np.mean((sums - floodlit)[known] ** 2 - variance[known]))
    share = float(np.sqrt(max(apart, 0.0) / power))
    grade = graded(share, limits.pair_sum)
    if grade:
        yield Finding(
            grade,
            f"the pair of exposures does not add up to the white photo: it is {percent(share)} "
            f"off (limit {percent(limits.pair_sum[0])}); look at ambient light and leaks "
            "(black_level), a lamp that drifts, an aperture that does not come back, or a missed "
            "refresh",
        )


def _of_the_rest(error: float, power: float) -> float:
    """RMS error over the RMS of what a picture has without it; both are mean squares."""
    return float(np.sqrt(error / (power - error))) if error < power else np.inf


def _error(share: float) -> str:
    return percent(share) if np.isfinite(share) else "as much as all that it shows"
