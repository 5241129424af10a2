"""Noise of an answer and how far it may be off: figures of its findings, from sums done by hand."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest

from pdcd.verdict.answer import (
    judge_error_bars,
    judge_negative_light,
    judge_noise,
    judge_pair_sum,
)
from pdcd.verdict.causes import Grade, VerdictFinding

BAD, DOUBTFUL = Grade.BAD, Grade.DOUBTFUL


def grades(findings: Iterable[VerdictFinding]) -> list[Grade]:
    return [f.grade for f in findings]


def of_the_rest(error: float) -> float:
    """RMS error over that of what is left of a picture of power 1."""
    return math.sqrt(error / (1.0 - error))


@pytest.mark.parametrize(
    ("cells", "single"),
    [(4, 4.0), (12, 12.0), (1000, 12.0)],  # three channels share their paths: 36 values are 12
)
def test_the_figure_is_kept_in_nineteen_of_twenty_photos(cells: int, single: float) -> None:
    """The variance of a sum of squares, and that of sigmas of three degrees of freedom."""
    image = np.ones((12, 3))
    wide = 1.0 + 1.645 * math.sqrt(2.0 / single * (1.0 + 1.0 / 3.0))
    least = 0.09 / 1.09  # over the rest of the picture it is the limit, 0.3 squared
    for error, found in ((1.05 * least, True), (0.95 * least, False)):
        sigma = np.full(image.shape, math.sqrt(error / wide))
        texts = [f.text for f in judge_error_bars(image, sigma, 0.0 * image, cells)]
        assert bool(texts) == found
        share = f"{100.0 * of_the_rest(error):.3g} %"
        assert all(f"off by {share} (RMS, limit 30 %)" in text for text in texts)


def test_one_strong_pixel_is_known_no_better_than_one_number() -> None:
    image, sigma = np.ones((300, 1)), np.zeros((300, 1))
    sigma[7] = math.sqrt(300.0 * 0.04)
    wide = 0.04 * (1.0 + 1.645 * math.sqrt(2.0 * 4.0 / 3.0))
    (found,) = judge_error_bars(image, sigma, 0.0 * image, 100)
    assert found.grade == DOUBTFUL
    assert f"off by {100.0 * of_the_rest(wide):.3g} % (RMS, limit 30 %)" in found.text


def test_where_nothing_is_known_or_nothing_errs_there_is_no_finding() -> None:
    image = np.ones((9, 3))
    assert list(judge_error_bars(image, 0.0 * image, 0.0 * image, 9)) == []
    assert list(judge_error_bars(np.nan * image, image, 0.0 * image, 9)) == []
    assert list(judge_error_bars(image, np.inf * image, 0.0 * image, 9)) == []
    assert list(judge_negative_light(np.nan * image, image)) == []
    assert list(judge_negative_light(-image, np.inf * image)) == []


def test_only_known_values_count() -> None:
    image, sigma, sensor = (np.full((40, 1), x) for x in (1.0, 0.01, 0.0))
    image[0], sigma[1], sensor[1] = np.nan, np.inf, np.inf
    sensor[0] = 99.0
    assert list(judge_error_bars(image, sigma, sensor, 40)) == []
    image[1], image[2] = -99.0, -1.0
    (found,) = judge_negative_light(image, np.where(np.isfinite(image), sensor, 0.0))
    below = 2.0 / 38.0
    assert f"off by {100.0 * of_the_rest(below):.3g} %" in found.text


@pytest.mark.parametrize(
    ("negative", "noise", "grade", "text"),
    [
        (1, 0.0, BAD, "off by 100 % or more (RMS, limit 15 %)"),
        (1, 0.25, DOUBTFUL, "off by 57.7 % or more"),
        (1, 0.5, None, ""),
        (1, 1.0, None, ""),
        (4, 0.0, BAD, "off by as much as all that it shows"),
    ],
)
def test_light_below_zero_is_half_of_the_error_without_the_noise(
    negative: int, noise: float, grade: Grade | None, text: str
) -> None:
    """Of four pixels of power 1 so many are below zero: half of it is error, less the sensor's."""
    image = np.where(np.arange(4) < negative, -1.0, 1.0)[:, None]
    found = list(judge_negative_light(image, np.full((4, 1), math.sqrt(noise))))
    assert grades(found) == ([] if grade is None else [grade])
    assert all(text in one.text for one in found)


@pytest.mark.parametrize(
    ("share", "grade"),
    [(0.2, []), (0.5, [DOUBTFUL]), (0.7, [DOUBTFUL]), (0.72, [BAD]), (3.0, [BAD])],
)
def test_an_answer_below_its_error_bars(share: float, grade: list[Grade]) -> None:
    """The root of a half of what the picture shows is as much as is left of it without the error;
    the bound is higher, but only sigma as it stands makes a photo bad."""
    image = np.ones((1000, 3))
    found = list(judge_error_bars(image, share * image, 0.01 * image, 1000, "maps"))
    assert grades(found) == grade
    assert all("pdcd calibrate registration" in f.text for f in found)  # and not more codes
    assert all(("all that it shows" in f.text) == (share > 1.0) for f in found)
    # What the sensor's noise explains was said of the sensor.
    assert grades(judge_error_bars(image, share * image, share * image, 1000)) == []


def test_an_answer_below_its_noise() -> None:
    image = np.ones((1000, 3))
    for noise, grade in ((0.1, []), (0.5, [DOUBTFUL]), (2.0, [BAD])):
        assert grades(judge_noise(image, 0.0 * image, noise * image)) == grade
    assert BAD in grades(judge_noise(0.0 * image, image, image))


def test_the_field_where_sigma_is_larger_than_the_answer() -> None:
    one, none = np.ones((8, 1)), np.zeros((8, 1))
    sigma = np.array([[1.0]] * 5 + [[1.01]] * 3)  # as large as the answer is not larger
    assert grades(judge_noise(one, sigma, none)) == []
    sigma[:5] = [[2.0], [0.0], [0.0], [0.0], [0.0]]
    (found,) = judge_noise(one, sigma, none)
    assert found.grade == DOUBTFUL
    assert found.text.startswith("in 50 % of the field sigma is larger than the answer (limit 50 %")


def test_what_is_unknown_of_an_answer_counts_for_nothing() -> None:
    image, sigma = np.ones((10, 1)), np.zeros((10, 1))
    sigma[:4], image[4], sigma[5:8] = np.inf, np.nan, 3.0
    sensor = np.where(np.isfinite(sigma) & np.isfinite(image), 0.1, 50.0)
    (found,) = judge_noise(image, sigma, sensor)
    assert found.grade == DOUBTFUL and found.text.startswith("in 60 % of the field")  # of 5 known
    for unknown in (np.nan * image, image[:0]):
        (found,) = judge_noise(unknown, sigma[: len(unknown)], sensor[: len(unknown)])
        assert found.grade == BAD and found.text.startswith("nothing is known")


def test_a_pair_that_does_not_add_up() -> None:
    one, none = np.ones((8, 1)), np.zeros((8, 1))
    for apart, grade in ((0.019, []), (0.021, [DOUBTFUL]), (-0.021, [DOUBTFUL]), (0.11, [BAD])):
        assert grades(judge_pair_sum(one + apart, one, none)) == grade
    # Noise of the sensor explains as much as it is.
    assert grades(judge_pair_sum(1.5 * one, one, 0.25 + none)) == []
    (found,) = judge_pair_sum(1.5 * one, one, 0.09 + none)
    assert "it is 40 % off (limit 2 %)" in found.text
    assert grades(judge_pair_sum(one, none, none)) == []


def test_a_pair_is_compared_where_both_are_known() -> None:
    sums, lit, variance = np.ones((4, 1)), np.ones((4, 1)), np.zeros((4, 1))
    sums[0], variance[0] = 99.0, np.inf
    assert grades(judge_pair_sum(sums, lit, variance)) == []
    variance[...] = np.inf
    assert grades(judge_pair_sum(sums, lit, variance)) == []
