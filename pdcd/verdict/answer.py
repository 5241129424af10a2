"""The verdict on the answer as a whole: its noise, its error bars, light below zero, and light in
it that belongs elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pdcd.arrays import Floats
from pdcd.pictures.picture import ErrorCause
from pdcd.recipes.parts import FLOODLIT
from pdcd.recipes.recipe import Extremes
from pdcd.runs.record import RunRecord
from pdcd.verdict.causes import Cause, Grade, VerdictFinding, judge
from pdcd.verdict.evidence import Evidence, compute_rms

_LIGHT = (
    "indirect", "direct", "fraction", "diagonal", "off-diagonal", "warped", "long-range",
    "short-range", "keyed", "epipolar", "stereo",
)  # fmt: skip
"""Goals whose answer is the light of paths, and so never below zero."""
_UPPER = 1.645
"""Standard deviations above the mean below which a normal variable lies in 19 of 20 cases."""
_FEWEST_CODES = 80
"""Least number of codes for a pilot and four parts (`pdcd.planning.defaults`)."""
_FREEDOM = 3.0
"""Degrees of freedom of a sigma that was measured by the fewest parts."""
_MOST_ERROR: Mapping[ErrorCause, str] = {
    "codes": "codes have large errors on sharp light, such as that of mirrors; take more codes",
    "maps": "light goes through the mask's wrong cells; run pdcd calibrate registration",
    "timing": "direct light gets through as the panels switch; take full guards",
    "stops": "how the light of two stops compares is not known well; take all photos at one stop",
}
"""What to say where error bars come mostly from this cause."""


def judge_answer(seen: Evidence) -> Iterator[VerdictFinding]:
    """All findings on the answer."""
    made, record, transport = seen.decoded.answer, seen.record, seen.decoded.transport
    recipe = seen.decoded.recipe
    if recipe.asked:
        yield from judge(Cause.ANSWER_MISSING, asked=recipe.asked, stands=recipe.answer_name)
    image, sigma, sensor = (seen.inside(p) for p in (made.image, made.sigma, made.sensor))
    yield from judge_noise(image, sigma, sensor)
    if transport is not None:
        yield from _judge_common_light(transport.common)
    else:
        target = recipe.target
        if made.kind == "measured":
            most: ErrorCause = max(made.causes, key=lambda one: made.causes[one], default="codes")
            yield from judge_error_bars(image, sigma, sensor, target.cells, most)
        if target.goal.name in _LIGHT:
            yield from judge_negative_light(image, sensor)
        if made.kind == "sensor":
            codes = record.how.codes
            advice = "4 parts: their spread measures it"
            if codes < _FEWEST_CODES:
                advice = f"{_FEWEST_CODES} codes or more, as four parts measure it"
            share = _error_by_single_paths(seen, image)
            yield from judge(Cause.CODES_UNMEASURED, share, advice=advice)
    yield from judge(Cause.LEAKS_LEFT, record.leak)
    yield from _judge_unseen_leaks(record, whole=made.kind == "whole")
    yield from judge(Cause.ROOM_CHANGED, record.room_changed)
    if FLOODLIT in seen.pictures:
        lit, both = seen.pictures[FLOODLIT], seen.pictures["white"]
        variance = seen.inside(lit.sensor) ** 2 + seen.inside(both.sensor) ** 2
        yield from judge_pair_sum(seen.inside(both.image), seen.inside(lit.image), variance)


def _judge_unseen_leaks(record: RunRecord, *, whole: bool) -> list[VerdictFinding]:
    """Ambient light and leaks that no photo shows. Codes count them several times; a `whole` photo,
    without codes, has them once, and who declined the dark photo may want them in it."""
    if record.leaks_unseen == "no":
        return []
    grade = Grade.REMARK if whole and record.leaks_unseen == "declined" else Grade.DOUBTFUL
    light = {"mask": "ambient light", "ambient": "what a closed mask lets through"}
    told = light.get(record.how.black_level, "ambient light and leaks")
    return judge(Cause.LEAKS_UNSEEN, grade=grade, light=told)


def judge_noise(image: Floats, sigma: Floats, sensor: Floats) -> Iterator[VerdictFinding]:
    """Whether the answer stands above its noise; (n, C) each, of pixels in the field.

    The sensor's noise decides; sigma decides only where it exceeds most of the picture.
    """
    known = np.isfinite(sigma) & np.isfinite(image)
    if not known.any():
        yield from judge(Cause.ANSWER_UNKNOWN)
        return
    rms, noise = compute_rms(image[known]), float(np.sqrt(np.mean(sensor[known] ** 2)))
    yield from judge(Cause.NOISE, noise / rms if rms > 0.0 else np.inf)
    yield from judge(Cause.UNSURE, float(np.mean(sigma[known] > rms)))


def judge_error_bars(
    image: Floats, sigma: Floats, sensor: Floats, cells: int, most: ErrorCause = "codes"
) -> Iterator[VerdictFinding]:
    """Findings from a measured sigma of the whole answer; (n, C) each, of pixels in the field of
    `cells` cells. most : the cause that most of it comes from.

    The actual square error of few strong pixels scatters about the one expected from sigma, and
    sigma itself about its own mean. So the figure is a bound that holds in 19 of 20 photos; a photo
    is bad only where sigma itself exceeds the limit. Where the sensor's noise alone is as bad,
    `judge_noise` has said so.
    """
    known = np.isfinite(sigma) & np.isfinite(image)
    squares = sigma[known] ** 2
    total = float(np.sum(squares))
    if not total > 0.0:
        return
    # Channels share their paths, and the quads of a cell share its codes.
    single = total**2 / float(np.sum(squares**2)) * min(cells / squares.size, 1.0 / 3.0)
    spread = float(np.sqrt(2.0 / max(single, 1.0) * (1.0 + 1.0 / _FREEDOM)))
    power, mean = float(np.mean(image[known] ** 2)), float(np.mean(squares))
    share = _over_the_rest(mean * (1.0 + _UPPER * spread), power)
    row = Cause.ERROR_BARS.value
    grade = max(min(row.grade(share), Grade.DOUBTFUL), row.grade(_over_the_rest(mean, power)))
    noise = _over_the_rest(float(np.mean(sensor[known] ** 2)), power)
    if grade > Cause.NOISE.value.grade(noise):
        yield from judge(Cause.ERROR_BARS, share, grade, why=_MOST_ERROR[most])


def judge_negative_light(image: Floats, sensor: Floats) -> Iterator[VerdictFinding]:
    """Light below zero, in a picture where no path takes light away; (n, C) each, of pixels in the
    field.

    Light below zero is certainly an error. Errors are as often negative as positive. So if a
    picture is all error half of its squares are below zero; where there is light, fewer are. No
    model of the scene is needed.
    """
    known = np.isfinite(sensor) & np.isfinite(image)
    if not known.any():
        return
    below = 2.0 * float(np.mean(np.minimum(image[known], 0.0) ** 2))
    # Noise has a finding of its own, and scatters below zero where there is no light.
    below -= float(np.mean(sensor[known] ** 2))
    power = float(np.mean(image[known] ** 2))
    yield from judge(Cause.BELOW_ZERO, _over_the_rest(max(below, 0.0), power))


def _over_the_rest(error: float, power: float) -> float:
    """RMS error over the RMS of the picture without it; `error` and `power` are mean squares."""
    return float(np.sqrt(error / (power - error))) if error < power else np.inf


def _error_by_single_paths(seen: Evidence, image: Floats) -> float:
    """RMS error by codes over the RMS of the answer, (n, C) in the field, if each point got all its
    indirect light by one path, whose weight is as wrong as those of all paths on average."""
    rule = seen.decoded.recipe.answer
    if isinstance(rule, Extremes):
        weights = dict.fromkeys(rule.photos, max(abs(rule.largest), abs(rule.smallest)))
    else:
        weights = {name: abs(weight) for weight, name in rule}
    all_light = seen.pictures.get("indirect", seen.pictures.get("white"))
    light = compute_rms(image if all_light is None else seen.inside(all_light.image))
    off = sum(weights[name] * seen.deviations[name].off_rms for name in weights)
    answer = compute_rms(image)
    return off * light / answer if answer > 0.0 else np.inf


def _judge_common_light(share: float) -> list[VerdictFinding]:
    """Judges the share of the light of a slice's photos that comes whatever is shown. It is in the
    picture of the scene under all patterns, and not in the entries of T."""
    rest = share / (1.0 - share) if share < 1.0 else np.inf
    return judge(Cause.COMMON_LIGHT, rest, share=share)


def judge_pair_sum(sums: Floats, floodlit: Floats, variance: Floats) -> Iterator[VerdictFinding]:
    """Whether a complement pair adds up to the floodlit photo; (n, C) each, of pixels in the field,
    `variance` that of their difference."""
    known = np.isfinite(variance)
    power = float(np.mean(floodlit[known] ** 2)) if known.any() else 0.0
    if power > 0.0:
        apart = float(np.mean((sums - floodlit)[known] ** 2 - variance[known]))
        yield from judge(Cause.PAIR_SUM, float(np.sqrt(max(apart, 0.0) / power)))
