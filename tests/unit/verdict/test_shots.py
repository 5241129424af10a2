"""What single shots tell: light beside noise, light beside the field, refreshes, and times."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from pdcd.runs.record import ShotRecord
from pdcd.sensor.profile import load_profile
from pdcd.verdict.causes import Grade, VerdictFinding
from pdcd.verdict.shots import (
    judge_dark_cells,
    judge_exposure_times,
    judge_levels,
    judge_light,
    judge_light_outside,
    judge_refreshes,
)

BAD, DOUBTFUL = Grade.BAD, Grade.DOUBTFUL


def told(findings: Iterable[VerdictFinding]) -> list[tuple[Grade, str]]:
    return [(f.grade, f.text) for f in findings]


def shot(name: str = "coded", **changed: object) -> ShotRecord:
    fields: dict[str, object] = {
        "name": name, "window": "whole", "raw": "raw/coded.dng", "sha256": "0" * 64,
        "size_bytes": 1, "iso": 100, "f_number": 8.0, "open_ns": 0, "close_ns": 2 * 10**9,
        "end_ns": (10**9, 10**9), "refreshes": 60, "missed": 0, "source": "swap",
        "verified": True, "level": 1.0, **changed,
    }  # fmt: skip
    return ShotRecord(**fields)  # type: ignore[arg-type]


@pytest.mark.parametrize(("level", "lit"), [(0.49, False), (0.51, True), (-9.0, False)])
def test_light_must_exceed_five_times_the_error_of_its_mean(level: float, lit: bool) -> None:
    """A hundred pixels of three channels with a variance of 3: the error of grey's mean is 0.1."""
    light, variance = np.full((100, 3), level), np.full((100, 3), 3.0)
    ((grade, text),) = told(judge_light("a", light, variance))
    assert grade == BAD and ("under-exposed" in text) == lit
    assert lit or f"its mean is {level / 0.1:.2g} times its error (limit 5)" in text


def test_without_any_error_no_light_is_none_all_the_same() -> None:
    for light in (0.0, -1.0, np.nan):
        ((grade, text),) = told(judge_light("a", np.full((9, 3), light), np.zeros((9, 3))))
        assert grade == BAD and "no light, its mean is 0 times its error" in text
    assert told(judge_light("a", np.ones((9, 3)), np.zeros((9, 3)))) == []


def test_no_pixel_that_sees_the_field_is_bad() -> None:
    ((grade, _),) = told(judge_light("coded", np.zeros((0, 3)), np.zeros((0, 3))))
    assert grade == BAD


@pytest.mark.parametrize(
    ("noise", "grade", "percent"),
    [(0.9, [DOUBTFUL], "47.4 %"), (1.0, [DOUBTFUL], "50 %"), (0.3, [], ""), (4.0, [BAD], "100 %")],
)
def test_noise_of_a_shot_over_its_light(noise: float, grade: list[Grade], percent: str) -> None:
    """Even light of 2, whose grey has that variance."""
    light, variance = np.full((900, 3), 2.0), np.full((900, 3), 3.0 * noise)
    found = told(judge_light("a", light, variance))
    assert [g for g, _ in found] == grade
    assert all(f"its noise is {percent} of its light (limit 30 %)" in text for _, text in found)


def test_the_light_of_a_shot_is_its_square_without_the_noise_and_no_less_than_its_mean() -> None:
    light = np.tile([[0.0], [2.0]], (500, 1))  # mean 1, mean square 2
    for noise, percent in ((0.5, "57.7 %"), (1.5, "122 %")):
        ((_, text),) = told(judge_light("a", light, np.full((1000, 1), noise)))
        assert f"its noise is {percent} of its light" in text


def test_light_outside_the_field_goes_by_medians() -> None:
    inside = np.array([4.0, 4.0, 400.0])
    for outside, grade in ((1.0, [DOUBTFUL]), (0.99, [])):
        found = judge_light_outside("a", inside, np.array([0.0, outside, 99.0]))
        assert [f.grade for f in found] == grade
    ((_, text),) = told(judge_light_outside("a", inside, np.full(3, 2.0)))
    assert "shot a has 50 % of the field's light outside it (limit 25 %)" in text
    for dark in (0.0 * inside, -inside, inside[:0]):
        assert told(judge_light_outside("a", dark, inside)) == []
    assert told(judge_light_outside("a", inside, inside[:0])) == []


def test_the_shutter_may_close_when_the_panels_are_black_and_no_sooner() -> None:
    late: dict[str, Any] = {"end_ns": (10**9, 15 * 10**8)}
    assert told(judge_refreshes([shot(close_ns=15 * 10**8, **late)])) == []
    shots = [shot("a", close_ns=14 * 10**8, **late), shot("b", close_ns=13 * 10**8, **late)]
    ((grade, text),) = told(judge_refreshes([shot(), *shots]))
    assert grade == BAD
    assert text.startswith("the shutter closed 0.2 s before the panels went black in shot a and 1")


def test_times_of_presentation_must_be_verified_where_anything_was_shown() -> None:
    ((grade, text),) = told(judge_refreshes([shot(), shot(verified=False, source="timer")]))
    assert grade == DOUBTFUL and "time source timer" in text
    assert told(judge_refreshes([shot(refreshes=0, verified=False, close_ns=0)])) == []


def test_refreshes_that_were_missed_are_counted_where_light_became_unequal() -> None:
    assert told(judge_refreshes([shot(), shot(missed=1)])) == []
    shots = [shot("a", level=None, missed=2), shot("b", missed=9), shot("c", level=None, missed=3)]
    ((grade, text),) = told(judge_refreshes(shots))
    assert grade == DOUBTFUL
    assert text.startswith("5 refreshes were missed in shot a and 1 more, so that")


def test_times_of_an_exposure_that_disagree_are_doubtful() -> None:
    shots = [shot(), shot("late", close_ns=82 * 10**8, planned_s=2.2), shot(planned_s=2.0)]
    ((grade, text),) = told(judge_exposure_times(shots, {"coded": 2.0}))
    assert grade == DOUBTFUL and "8.2 s" in text and "2.2 s" in text and "shot late" in text
    ((grade, text),) = told(judge_exposure_times([shot()], {"coded": 0.005}))
    assert grade == DOUBTFUL and "0.005 s" in text
    assert not judge_exposure_times([shot(planned_s=2.0)], {})


@pytest.mark.parametrize(
    ("black", "white", "times"),
    [(64.0, 4095.0, None), (0.0, 4095.0, None), (64.0, 3400.0, None), (1024.0, 65520.0, "16 times"),
     (64.0, 65535.0, "16.2 times"), (16.0, 1023.0, "0.25 times")],
)  # fmt: skip
def test_a_file_and_a_profile_have_numbers_of_one_size(
    black: float, white: float, times: str | None
) -> None:
    """Samples of 12 bits, shifted left by four, or taken for those of 10: which is right nobody
    knows, and electrons go by the profile."""
    found = told(judge_levels({"black_dn": [black], "white_dn": white}, load_profile("mono")))
    assert [grade for grade, _ in found] == [DOUBTFUL] * (times is not None)
    assert all(times and f"{times} as many as in sensor profile mono" in text for _, text in found)


def test_a_photo_that_is_worked_out_has_no_levels() -> None:
    assert told(judge_levels({}, load_profile("mono"))) == []


def dark_where(grid: tuple[int, int], *places: Any) -> list[tuple[Grade, str]]:
    dark = np.zeros(grid, np.bool_)
    for place in places:
        dark[place] = True
    return told(judge_dark_cells((dark.ravel(), np.ones(dark.size, np.bool_)), grid))


def test_black_things_are_a_remark_and_lines_without_light_a_reason() -> None:
    grid = 20, 30
    assert not dark_where(grid, np.s_[4, 4:9])  # 5 of 600
    ((grade, text),) = dark_where(grid, np.s_[4:9, 4:14])
    assert grade == Grade.REMARK and text.startswith("50 of 600 cells have no light in the white")
    ((grade, text),) = dark_where(grid, np.s_[4:9], np.s_[:, 20])
    assert grade == DOUBTFUL and "5 whole rows and 1 whole columns between lit ones" in text
    # At an edge a scene may end, and a thing may be almost as wide as the field.
    ((grade, _),) = dark_where(grid, np.s_[:5], np.s_[:, 28:])
    assert grade == Grade.REMARK
    ((grade, _),) = dark_where(grid, np.s_[4:9, 1:])
    assert grade == Grade.REMARK
    ((grade, _),) = dark_where((1, 30), np.s_[:, 4:9])  # of one row a column is a cell
    assert grade == Grade.REMARK
    ((grade, _),) = dark_where(grid, np.s_[:])
    assert grade == Grade.REMARK


def test_what_nobody_sees_is_neither_dark_nor_lit() -> None:
    grid = 20, 30
    dark, known = np.zeros((2, *grid), np.bool_)
    known[:, 5:25] = True
    dark[4:9, 5:25] = True
    ((grade, text),) = told(judge_dark_cells((dark.ravel(), known.ravel()), grid))
    assert grade == DOUBTFUL and "100 of 400 cells" in text and "5 whole rows between" in text
