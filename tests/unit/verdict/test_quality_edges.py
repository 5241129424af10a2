"""Findings of the verdict exactly at their limits and just below, with the figures they tell."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from pdcd.probing.deviation import Deviation
from pdcd.runs.record import ShotRecord
from pdcd.verdict import answer, quality
from pdcd.verdict.limits import Grade, VerdictFinding, VerdictLimits
from pdcd.verdict.placement import PlacementFit

BAD, DOUBTFUL = Grade.BAD, Grade.DOUBTFUL


def told(findings: Iterable[VerdictFinding]) -> list[tuple[Grade, str]]:
    return [(f.grade, f.text) for f in findings]


def grades(findings: Iterable[VerdictFinding]) -> list[Grade]:
    return [f.grade for f in findings]


def shot(name: str = "coded", **changed: object) -> ShotRecord:
    fields: dict[str, object] = {
        "name": name, "window": "whole", "raw": "raw/coded.dng", "sha256": "0" * 64,
        "size_bytes": 1, "iso": 100, "f_number": 8.0, "open_ns": 0, "close_ns": 2 * 10**9,
        "end_ns": (10**9, 10**9), "refreshes": 60, "missed": 0, "source": "swap",
        "verified": True, "level": 1.0, **changed,
    }  # fmt: skip
    return ShotRecord(**fields)  # type: ignore[arg-type]


def test_the_limits_are_those_of_the_manual() -> None:
    """The table of docs/quality.md."""
    assert dataclasses.asdict(VerdictLimits()) == {
        "saturated": (0.002, 0.05), "noise": (0.3, 1.0), "noisy_shot": (0.3, 1.0), "dark": 5.0,
        "error": (0.3, 1.0), "unmeasured": 0.1, "exact": 0.003, "below": (0.15, 1.0),
        "unsure": (0.5, 0.9),
        "stray": (0.25, 1.0), "room": (0.1, 1.0), "changed": 0.05, "beyond": 0.06,
        "left": (0.05, 0.3), "torn": (0.1, 0.5), "outside": 0.25,
        "direct": 0.15, "inverted": -0.2,
        "fingerprint": (0.3, 6.0), "diagonal": (0.1, 0.5), "direct_left": (0.15, 0.5),
        "misplaced": (0.06, 0.4), "pair_sum": (0.02, 0.1), "off_rms": (1.0, 3.0), "followed": 1.5,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("share", "grade"),
    [(0.0019, []), (0.002, [DOUBTFUL]), (0.0499, [DOUBTFUL]), (0.05, [BAD]), (1.0, [BAD])],
)
def test_saturation_from_its_limits_on(share: float, grade: list[Grade]) -> None:
    assert grades(quality.judge_saturation({"a": 0.0, "b": share, "c": 0.0})) == grade


def test_saturation_names_the_worst_shot_its_share_and_the_limit() -> None:
    ((_, text),) = told(quality.judge_saturation({"a": 0.004, "b": 0.01, "c": 0.003}))
    assert text.startswith("shot b: 1 % of the field is saturated (limit 0.2 %)")
    assert told(quality.judge_saturation({})) == []


@pytest.mark.parametrize(("level", "lit"), [(0.5, False), (0.5001, True), (-9.0, False)])
def test_light_must_exceed_five_times_the_error_of_its_mean(level: float, lit: bool) -> None:
    """A hundred pixels of three channels with a variance of 3: the error of grey's mean is 0.1."""
    light, variance = np.full((100, 3), level), np.full((100, 3), 3.0)
    ((grade, text),) = told(quality.judge_light("a", light, variance))
    assert grade == BAD and ("under-exposed" in text) == lit
    assert lit or f"its mean is {level / 0.1:.2g} times its error (limit 5)" in text


def test_without_any_error_no_light_is_none_all_the_same() -> None:
    ((grade, text),) = told(quality.judge_light("a", np.zeros((9, 3)), np.zeros((9, 3))))
    assert grade == BAD and "its mean is 0 times its error" in text
    assert told(quality.judge_light("a", np.ones((9, 3)), np.zeros((9, 3)))) == []


@pytest.mark.parametrize(
    ("noise", "grade", "percent"),
    [(0.9, [DOUBTFUL], "47.4 %"), (1.0, [DOUBTFUL], "50 %"), (0.3, [], ""), (4.0, [BAD], "100 %")],
)
def test_noise_of_a_shot_over_its_light(noise: float, grade: list[Grade], percent: str) -> None:
    """Even light of 2, whose grey has that variance."""
    light, variance = np.full((900, 3), 2.0), np.full((900, 3), 3.0 * noise)
    found = told(quality.judge_light("a", light, variance))
    assert [g for g, _ in found] == grade
    assert all(f"its noise is {percent} of its light (limit 30 %)" in text for _, text in found)


def test_the_noise_limit_itself_is_doubtful() -> None:
    limits = VerdictLimits(noisy_shot=(0.5, 2.0))
    light = np.full((900, 1), 2.0)
    assert grades(quality.judge_light("a", light, 0.0 * light + 1.0, limits)) == [DOUBTFUL]
    assert grades(quality.judge_light("a", light, 0.0 * light + 0.999, limits)) == []


def test_the_light_of_a_shot_is_its_square_without_the_noise_and_no_less_than_its_mean() -> None:
    light = np.tile([[0.0], [2.0]], (500, 1))  # mean 1, mean square 2
    for noise, percent in ((0.5, "57.7 %"), (1.5, "122 %")):
        ((_, text),) = told(quality.judge_light("a", light, np.full((1000, 1), noise)))
        assert f"its noise is {percent} of its light" in text


def test_noise_and_sigma_of_an_answer_at_their_limits() -> None:
    limits = VerdictLimits(noise=(0.5, 1.0))
    one, none = np.ones((8, 1)), np.zeros((8, 1))
    for level, found in ((0.499, []), (0.5, [DOUBTFUL]), (0.999, [DOUBTFUL]), (1.0, [BAD])):
        assert grades(answer.judge_noise(one, none, level * one, limits)) == found
    ((_, text),) = told(answer.judge_noise(one, none, 0.5 * one))
    assert text.startswith("the sensor's noise is 50 % of the answer (limit 30 %)")
    sigma = np.array([[1.0]] * 5 + [[1.01]] * 3)  # as large as the answer is not larger
    assert told(answer.judge_noise(one, sigma, none)) == []
    sigma[:5] = [[2.0], [0.0], [0.0], [0.0], [0.0]]
    ((grade, text),) = told(answer.judge_noise(one, sigma, none))
    assert grade == DOUBTFUL and text.startswith("in 50 % of the field sigma is larger")
    assert "(limit 50 %)" in text


def test_what_is_unknown_of_an_answer_counts_for_nothing() -> None:
    image, sigma = np.ones((10, 1)), np.zeros((10, 1))
    sigma[:4], image[4], sigma[5:8] = np.inf, np.nan, 3.0
    sensor = np.where(np.isfinite(sigma) & np.isfinite(image), 0.1, 50.0)
    ((grade, text),) = told(answer.judge_noise(image, sigma, sensor))
    assert grade == DOUBTFUL and text.startswith("in 60 % of the field")  # 3 of the 5 known
    image[...] = np.nan
    ((grade, text),) = told(answer.judge_noise(image, sigma, sensor))
    assert grade == BAD and text.startswith("nothing is known")


@pytest.mark.parametrize(
    ("black", "lit", "leak", "grade"),
    [
        (0.5, 1.0, 0.25, [DOUBTFUL]), (0.49, 1.0, 0.25, []), (2.5, 2.0, 0.25, [BAD]),
        (2.48, 2.0, 0.25, [DOUBTFUL]), (1.0, 0.0, 0.0, []), (-1.0, -0.5, 0.0, []),
    ],
)  # fmt: skip
def test_stray_light_from_its_limits_on(
    black: float, lit: float, leak: float, grade: list[Grade]
) -> None:
    found = told(quality.judge_stray_light("a", black, lit, leak))
    assert [g for g, _ in found] == grade
    assert all(f"shot a has {100 * (black / lit - leak):.3g} % of" in text for _, text in found)


def test_the_rooms_light_counts_from_a_tenth_of_white_on() -> None:
    for share, grade in ((0.099, []), (0.1, [DOUBTFUL]), (0.99, [DOUBTFUL]), (1.0, [BAD])):
        assert grades(quality.judge_room_light(share, "a")) == grade


def test_a_room_that_changed_is_doubtful_and_never_bad() -> None:
    """Nobody knows whether the photos of the answer saw the change."""
    for error, grade in ((0.049, []), (0.05, [DOUBTFUL]), (20.0, [DOUBTFUL])):
        assert grades(quality.judge_room_change(error)) == grade


def test_light_that_was_not_taken_off_counts_from_its_limits_on() -> None:
    for error, grade in ((0.0499, []), (0.05, [DOUBTFUL]), (0.299, [DOUBTFUL]), (0.3, [BAD])):
        assert grades(answer.judge_leak(error)) == grade
    ((_, text),) = told(answer.judge_leak(0.2))
    assert "are 20 % of the answer and were not taken off (limit 5 %)" in text


def test_torn_windows_count_from_their_limits_on() -> None:
    for share, grade in ((0.099, []), (0.1, [DOUBTFUL]), (0.499, [DOUBTFUL]), (0.5, [BAD])):
        assert grades(quality.judge_warp_tears(share)) == grade
    ((_, text),) = told(quality.judge_warp_tears(0.25))
    assert "25 % of the cells share windows" in text and "take whole windows" in text


def test_light_outside_the_field_goes_by_medians() -> None:
    inside = np.array([4.0, 4.0, 400.0])
    for outside, grade in ((1.0, [DOUBTFUL]), (0.99, [])):
        assert (
            grades(quality.judge_light_outside("a", inside, np.array([0.0, outside, 99.0])))
            == grade
        )
    ((_, text),) = told(quality.judge_light_outside("a", inside, np.full(3, 2.0)))
    assert "shot a has 50 % of the field's light outside it (limit 25 %)" in text
    assert told(quality.judge_light_outside("a", 0.0 * inside, inside)) == []
    assert told(quality.judge_light_outside("a", -inside, inside)) == []
    assert told(quality.judge_light_outside("a", np.zeros(0), inside)) == []


def test_a_fingerprint_needs_more_than_its_share_and_more_than_chance() -> None:
    untold = np.zeros(0)
    for share, chance, sure in (
        (0.3, 60.0, False), (0.9, 6.0, False), (0.301, 6.01, True), (-0.301, -6.01, True),
        (0.29, 60.0, False), (0.9, 5.9, False),
    ):  # fmt: skip
        found = grades(
            quality.judge_panel_places(untold, [PlacementFit("mirrored", share, chance)], [])
        )
        assert found == [BAD] * sure
        assert (
            grades(
                quality.judge_panel_places(untold, [], [PlacementFit("mirrored", share, chance)])
            )
            == found
        )


def test_a_photo_with_more_direct_light_in_place_speaks_of_the_scene() -> None:
    for middle, grade in ((0.34, [BAD]), (0.35, []), (0.9, [])):
        shares = np.array([0.0, middle, 1.0])
        for share in (0.35, -0.35):
            fit = PlacementFit("mirrored", share, 9.0 * np.sign(share))
            assert grades(quality.judge_panel_places(shares, [fit], [])) == grade
            assert grades(quality.judge_panel_places(shares, [], [fit])) == [BAD]


def test_the_surest_of_wrong_places_is_named() -> None:
    fits = [
        PlacementFit("a", 0.9, 7.0),
        PlacementFit("b", -0.5, -9.0),
        PlacementFit("c", 0.8, 8.0),
        PlacementFit("d", 0.2, 90.0),
    ]
    ((_, text),) = told(quality.judge_panel_places(np.zeros(0), fits, []))
    assert text.startswith("a panel is b and inverted: 50 % of the light follows codes")
    ((_, text),) = told(quality.judge_panel_places(np.zeros(0), fits[:1], []))
    assert text.startswith("a panel is a: 90 %") and "(limit 30 %)" in text
    ((_, text),) = told(
        quality.judge_panel_places(np.zeros(0), [], [PlacementFit("as believed", -0.4, -7.0)])
    )
    assert text.startswith("a panel is inverted: 40 %")


def test_the_best_tenth_of_all_places_must_have_direct_light() -> None:
    for count, grade in ((2, []), (1, [DOUBTFUL])):  # of eleven the second best counts
        shares = np.array([0.2] * count + [0.0] * (11 - count))
        assert grades(quality.judge_panel_places(shares, [], [])) == grade
    assert grades(quality.judge_panel_places(np.full(7, 0.15), [], [])) == []
    ((_, text),) = told(quality.judge_panel_places(np.full(7, 0.125), [], []))
    assert "(at most 12.5 % in nine of ten places, limit 15 %)" in text


def test_less_direct_light_than_none_is_an_inverted_panel() -> None:
    half = np.array([-0.3, -0.2, 0.9])  # the median is the limit: not below it
    assert grades(quality.judge_panel_places(half, [], [])) == []
    ((grade, text),) = told(quality.judge_panel_places(np.array([-0.3, -0.25, 0.9]), [], []))
    assert grade == BAD and "(direct light -25 %, limit -20 %)" in text


def test_single_codes_speak_of_direct_light_before_all_else() -> None:
    for share, grade in ((0.5, []), (0.1, [DOUBTFUL])):
        stack = [PlacementFit("as believed", share, 3.0), PlacementFit("mirrored", -0.9, -3.0)]
        assert grades(quality.judge_panel_places(np.full(9, -0.9), [], stack)) == grade
        assert grades(quality.judge_panel_places(np.zeros(0), [], stack)) == grade


def test_the_shutter_may_close_when_the_panels_are_black_and_no_sooner() -> None:
    late: dict[str, Any] = {"end_ns": (10**9, 15 * 10**8)}
    assert told(quality.judge_refreshes([shot(close_ns=15 * 10**8, **late)])) == []
    shots = [shot("a", close_ns=14 * 10**8, **late), shot("b", close_ns=13 * 10**8, **late)]
    ((grade, text),) = told(quality.judge_refreshes([shot(), *shots]))
    assert grade == BAD
    assert text.startswith("the shutter closed 0.2 s before the panels went black in shot a and 1")


def test_shots_without_refreshes_need_no_times() -> None:
    assert told(quality.judge_refreshes([shot(refreshes=0, verified=False, close_ns=0)])) == []


def test_refreshes_that_were_missed_are_counted_where_light_became_unequal() -> None:
    shots = [shot("a", level=None, missed=2), shot("b", missed=9), shot("c", level=None, missed=3)]
    ((grade, text),) = told(quality.judge_refreshes(shots))
    assert grade == DOUBTFUL
    assert text.startswith("5 refreshes were missed in shot a and 1 more, so that")


@pytest.mark.parametrize(
    ("diagonal", "off", "grade"),
    [
        (0.0999, 0.999, []), (0.1, 0.0, [DOUBTFUL]), (-0.1, 0.0, [DOUBTFUL]),
        (-0.5, 0.0, [BAD]), (0.0, 1.0, [DOUBTFUL]), (0.0, 3.0, [BAD]), (0.499, 2.99, [1, 1]),
    ],
)  # fmt: skip
def test_deviations_from_their_limits_on(diagonal: float, off: float, grade: list[int]) -> None:
    good, one = (
        Deviation(weight_s=1.0, diagonal_max=9.0, diagonal_mean=d, off_rms=o, off_rms_worst=9.0)
        for d, o in ((0.0, 0.0), (diagonal, off))
    )
    found = told(quality.judge_deviations({"good": good, "a": one}))
    assert [int(g) for g, _ in found] == [int(g) for g in grade]
    assert all(text.startswith("photo a: ") for _, text in found)


def test_direct_light_left_counts_a_third_where_it_was_taken_out() -> None:
    one = np.ones((4, 3))
    for weight, taken_out, grade in (
        (0.149, False, []), (0.15, False, [DOUBTFUL]), (0.5, False, [BAD]),
        (0.44, True, []), (0.46, True, [DOUBTFUL]), (1.49, True, [DOUBTFUL]), (1.51, True, [BAD]),
    ):  # fmt: skip
        assert grades(quality.judge_direct_light(weight, one, one, taken_out=taken_out)) == grade
    ((_, text),) = told(quality.judge_direct_light(0.1, 4.0 * one, 2.0 * one, taken_out=False))
    assert text.startswith("20 % of the picture is direct light (limit 15 %), which has a weight")
    assert "weight of 10 % in it" in text


def test_direct_light_that_no_photo_shows_counts_ten_times() -> None:
    for weight, grade in ((0.0149, []), (0.015, [DOUBTFUL]), (0.0499, [DOUBTFUL]), (0.05, [BAD])):
        assert grades(quality.judge_unseen_direct(weight)) == grade
    ((_, text),) = told(quality.judge_unseen_direct(0.02))
    assert "a weight of 2 % (limit 1.5 %)" in text


def test_a_pair_that_does_not_add_up() -> None:
    one, none = np.ones((8, 1)), np.zeros((8, 1))
    limits = VerdictLimits(pair_sum=(0.5, 1.0))
    for apart, grade in ((0.49, []), (0.5, [DOUBTFUL]), (-0.5, [DOUBTFUL]), (1.0, [BAD])):
        assert grades(answer.judge_pair_sum(one + apart, one, none, limits)) == grade
    # Noise of the sensor explains as much as it is.
    assert told(answer.judge_pair_sum(1.5 * one, one, 0.25 + none)) == []
    ((_, text),) = told(answer.judge_pair_sum(1.5 * one, one, 0.09 + none))
    assert "it is 40 % off (limit 2 %)" in text
    assert told(answer.judge_pair_sum(one, none, none)) == []


def test_a_pair_is_compared_where_both_are_known() -> None:
    sums, lit, variance = np.ones((4, 1)), np.ones((4, 1)), np.zeros((4, 1))
    sums[0], variance[0] = 99.0, np.inf
    assert told(answer.judge_pair_sum(sums, lit, variance)) == []
    variance[...] = np.inf
    assert told(answer.judge_pair_sum(sums, lit, variance)) == []
