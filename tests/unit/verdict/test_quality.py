"""Every finding of the verdict comes with its fault, and stays away without it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from pdcd.probing.deviation import Deviation
from pdcd.runs.record import ShotRecord
from pdcd.verdict import answer, quality
from pdcd.verdict.answer import judge_error_bars, judge_negative_light
from pdcd.verdict.limits import Grade, VerdictFinding, combine_findings
from pdcd.verdict.placement import PlacementFit

RNG = np.random.default_rng(0)
BAD, DOUBTFUL = Grade.BAD, Grade.DOUBTFUL


def grades(findings: object) -> list[Grade]:
    return [f.grade for f in findings]  # type: ignore[attr-defined]


def shot(**changed: object) -> ShotRecord:
    fields: dict[str, object] = {
        "name": "coded", "window": "whole", "raw": "raw/coded.dng", "sha256": "0" * 64,
        "size_bytes": 1, "iso": 100, "f_number": 8.0, "open_ns": 0, "close_ns": 2 * 10**9,
        "end_ns": (10**9, 10**9), "refreshes": 60, "missed": 0, "source": "swap",
        "verified": True, "level": 1.0, **changed,
    }  # fmt: skip
    return ShotRecord(**fields)  # type: ignore[arg-type]


def test_the_worst_finding_decides_and_comes_first() -> None:
    found = [
        VerdictFinding(Grade.REMARK, "r"),
        VerdictFinding(DOUBTFUL, "d"),
        VerdictFinding(BAD, "b"),
    ]
    made = combine_findings(found)
    assert (made.verdict, made.reasons, made.remarks) == ("bad", ("b", "d"), ("r",))
    assert combine_findings(found[:2]).verdict == "doubtful"
    alone = combine_findings(found[:1])
    assert (alone.verdict, alone.reasons, alone.remarks) == ("good", (), ("r",))
    assert combine_findings([]).verdict == "good"


def test_every_pixel_saturated_is_bad() -> None:
    assert grades(quality.judge_saturation({"white": 0.0, "coded": 0.001})) == []
    assert grades(quality.judge_saturation({"white": 0.0, "coded": 0.01})) == [DOUBTFUL]
    (worst,) = quality.judge_saturation({"white": 1.0, "coded": 0.01})
    assert worst.grade == BAD and "shot white: 100 % of the field" in worst.text
    none = np.full((100, 3), np.inf)
    assert grades(answer.judge_noise(np.ones((100, 3)), none, none)) == [BAD]


@pytest.mark.parametrize(
    ("level", "grade"), [(0.0, [BAD]), (1.0, [DOUBTFUL]), (0.3, [BAD]), (10.0, [])]
)
def test_noise_against_light(level: float, grade: list[Grade]) -> None:
    """The noise of grey is 1 / sqrt(3): 58 % of a light of 1."""
    variance = np.ones((4000, 3))
    light = level + RNG.normal(size=variance.shape)
    assert grades(quality.judge_light("coded", light, variance)) == grade


def test_no_pixel_that_sees_the_field_is_bad() -> None:
    none = np.zeros((0, 3))
    assert grades(quality.judge_light("coded", none, none)) == [BAD]
    assert grades(answer.judge_noise(none, none, none)) == [BAD]


def test_an_answer_below_its_noise() -> None:
    image = np.ones((1000, 3))
    assert grades(answer.judge_noise(image, 0.1 * image, 0.1 * image)) == []
    assert grades(answer.judge_noise(image, 0.5 * image, 0.5 * image)) == [DOUBTFUL]
    assert grades(answer.judge_noise(image, 2.0 * image, 0.1 * image)) == [BAD]
    assert BAD in grades(answer.judge_noise(0.0 * image, image, image))


@pytest.mark.parametrize(
    ("share", "grade"), [(0.2, []), (0.5, [DOUBTFUL]), (0.8, [BAD]), (3.0, [BAD])]
)
def test_an_answer_below_its_error_bars(share: float, grade: list[Grade]) -> None:
    """0.8 of what the picture shows is 1.33 of what is left of it without the error."""
    image = np.ones((1000, 3))
    found = list(judge_error_bars(image, share * image, 0.01 * image, 1000))
    assert grades(found) == grade
    assert all(("all that it shows" in f.text) == (share > 1.0) for f in found)
    # What the sensor's noise explains was said of the sensor.
    assert grades(judge_error_bars(image, share * image, share * image, 1000)) == []


def test_an_error_in_few_places_is_less_sure() -> None:
    image, sigma = np.ones((1000, 3)), np.zeros((1000, 3))
    sigma[:20] = 0.25 * np.sqrt(50.0)
    assert grades(judge_error_bars(image, sigma, 0.0 * image, 1000)) == [DOUBTFUL]
    even = np.full((1000, 3), 0.25)
    assert grades(judge_error_bars(image, even, 0.0 * image, 1000)) == []


@pytest.mark.parametrize(("error", "grade"), [(0.05, []), (0.3, [DOUBTFUL]), (20.0, [BAD])])
def test_light_below_zero_is_error(error: float, grade: list[Grade]) -> None:
    """A third of the field has light, all of it errs; noise below zero is no finding."""
    truth = np.where(np.arange(4000) % 3 == 0, 1.0, 0.0)[:, None] * np.ones(3)
    noise = 0.3 * np.ones(truth.shape)
    image = truth + error * RNG.normal(size=truth.shape)
    assert grades(judge_negative_light(image, 0.0 * noise)) == grade
    image = truth + noise * RNG.normal(size=truth.shape)
    assert grades(judge_negative_light(image, noise)) == []


def test_light_in_the_black_shot_beyond_the_leak() -> None:
    assert grades(quality.judge_stray_light("white-black-primal", 0.31, 1.0, 0.3)) == []
    assert grades(quality.judge_stray_light("white-black-primal", 0.6, 1.0, 0.3)) == [DOUBTFUL]
    assert grades(quality.judge_stray_light("white-black-primal", 2.0, 1.0, 0.3)) == [BAD]


def test_light_beside_the_field() -> None:
    lit, dark = np.ones(100), np.full(50, 0.01)
    assert grades(quality.judge_light_outside("white", lit, dark)) == []
    assert grades(quality.judge_light_outside("white", lit, lit)) == [DOUBTFUL]
    assert grades(quality.judge_light_outside("white", lit, np.zeros(0))) == []


def test_misplaced_panels_are_named() -> None:
    good = np.full(1000, 0.9)
    chance = PlacementFit("mirrored left to right", 0.95, 3.0)
    weak = PlacementFit("mirrored left to right", 0.1, 30.0)
    of_a_book = PlacementFit("mirrored left to right", 0.35, 30.0)
    assert grades(quality.judge_panel_places(good, [of_a_book], [])) == []
    assert grades(quality.judge_panel_places(good[:0], [of_a_book], [])) == [BAD]
    assert grades(quality.judge_panel_places(0.3 * good, [of_a_book], [])) == [BAD]
    more_than_all = PlacementFit("mirrored left to right", 4.9, 8.0)
    assert grades(quality.judge_panel_places(good[:0], [more_than_all], [])) == []
    assert (
        grades(
            quality.judge_panel_places(
                good, [chance, weak], [PlacementFit("as believed", 0.9, 90.0)]
            )
        )
        == []
    )
    elsewhere = 0.02 * good
    (found,) = quality.judge_panel_places(
        elsewhere, [PlacementFit("turned by 180 degrees", -0.9, -40.0)], []
    )
    assert found.grade == BAD and "turned by 180 degrees and inverted: 90 %" in found.text
    assert grades(quality.judge_panel_places(good[:0], [of_a_book], [], upright=True)) == []
    (found,) = quality.judge_panel_places(
        good, [], [PlacementFit("as believed", -0.9, -90.0)], upright=True
    )
    assert found.grade == BAD and "a panel is inverted" in found.text
    (found,) = quality.judge_panel_places(good, [], [PlacementFit("as believed", -0.9, -90.0)])
    assert found.grade == BAD and "a panel is inverted" in found.text
    assert grades(quality.judge_panel_places(-good, [], [])) == [BAD]
    assert grades(quality.judge_panel_places(0.02 * good, [], [])) == [DOUBTFUL]
    assert grades(
        quality.judge_panel_places(np.zeros(0), [], [PlacementFit("as believed", 0.01, 1.0)])
    ) == [DOUBTFUL]
    assert grades(quality.judge_panel_places(np.zeros(0), [], [])) == []


def test_refreshes_and_the_shutter() -> None:
    assert grades(quality.judge_refreshes([shot(), shot(missed=1)])) == []
    assert grades(quality.judge_refreshes([shot(level=None, missed=3)])) == [DOUBTFUL]
    (found,) = quality.judge_refreshes([shot(), shot(verified=False, source="timer")])
    assert found.grade == DOUBTFUL and "time source timer" in found.text
    (found,) = quality.judge_refreshes([shot(close_ns=10**9 - 10**8)])
    assert found.grade == BAD and "0.1 s before" in found.text


def test_a_probing_matrix_far_from_the_wanted_one() -> None:
    def of(diagonal: float, off: float) -> dict[str, Deviation]:
        one = Deviation(
            weight_s=1.0, diagonal_max=1.0, diagonal_mean=diagonal, off_rms=off, off_rms_worst=off
        )
        return {"coded": one}

    assert grades(quality.judge_deviations(of(0.01, 0.5))) == []
    assert grades(quality.judge_deviations(of(-0.2, 0.5))) == [DOUBTFUL]
    assert grades(quality.judge_deviations(of(0.9, 5.0))) == [BAD, BAD]


def test_weights_of_direct_light_from_cell_to_cell() -> None:
    assert grades(quality.judge_direct_weights({"matched": 0.0, "other": 0.29})) == []
    assert grades(quality.judge_direct_weights({"matched": 0.57, "other": 1.2})) == [DOUBTFUL, BAD]


def test_direct_light_in_a_picture_without_any() -> None:
    direct, answer = np.full((50, 3), 10.0), np.ones((50, 3))
    direct[0], answer[1] = np.nan, np.inf
    left = partial(quality.judge_direct_light, direct=direct, answer=answer)
    assert grades(left(0.01, taken_out=False)) == []
    assert grades(left(0.02, taken_out=False)) == [DOUBTFUL]
    (found,) = left(0.06, taken_out=False)
    assert found.grade == BAD and found.text.startswith("60 % of the picture is direct light")
    assert grades(left(0.04, taken_out=True)) == []
    (found,) = left(0.06, taken_out=True)
    assert found.grade == DOUBTFUL and "as strong as 60 % of the picture was taken" in found.text
    assert grades(quality.judge_direct_light(0.06, direct, 0.0 * direct, taken_out=False)) == []


@pytest.mark.parametrize(
    ("share", "told"), [(0.0, False), (0.19, False), (0.21, True), (0.5, True), (1.0, True)]
)
def test_light_that_comes_whatever_is_shown_of_a_slice(share: float, told: bool) -> None:
    """A quarter of the light that patterns bring is a fifth of all."""
    found = list(answer.judge_common_light(share))
    assert [f.grade for f in found] == [Grade.DOUBTFUL] * told
    if told:
        assert f"{100.0 * share:.3g} % of the light" in found[0].text
        assert "entries of T are without it" in found[0].text


@pytest.mark.parametrize(
    ("codes", "grade", "advice"),
    [
        (16, [DOUBTFUL], "take 80 codes or more"),
        (64, [DOUBTFUL], "take 80 codes or more"),
        (96, [DOUBTFUL], "take --parts 4"),
        (128, [Grade.REMARK], "take --parts 4"),
        (10**6, [], ""),
    ],
)
def test_codes_that_nothing_measured_are_told(codes: int, grade: list[Grade], advice: str) -> None:
    """One path in each point errs by 1 / sqrt(K) of the light; 16 codes once erred by 22.7 %."""
    found = list(answer.judge_unmeasured_codes(codes**-0.5, codes))
    assert grades(found) == grade
    for one in found:
        assert one.text.startswith("codes are not in the error bar") and advice in one.text
        assert f"off by {100.0 * codes**-0.5:.3g} % (RMS, limit 10 %)" in one.text


def test_times_of_an_exposure_that_disagree_are_doubtful() -> None:
    shots = [shot(), shot(name="late", close_ns=82 * 10**8, planned_s=2.2), shot(planned_s=2.0)]
    ((grade, text),) = [
        (f.grade, f.text) for f in quality.judge_exposure_times(shots, {"coded": 2.0})
    ]
    assert grade == DOUBTFUL and "8.2 s" in text and "2.2 s" in text and "shot late" in text
    ((grade, text),) = [
        (f.grade, f.text) for f in quality.judge_exposure_times([shot()], {"coded": 0.005})
    ]
    assert grade == DOUBTFUL and "0.005 s" in text
    assert not list(quality.judge_exposure_times([shot(planned_s=2.0)], {}))
