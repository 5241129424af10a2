"""The table of the verdict: every cause at its limits, and in the manual."""

from __future__ import annotations

import math
from pathlib import Path
from string import Formatter
from typing import Any

import numpy as np
import pytest

from pdcd.printable import to_percent
from pdcd.verdict.causes import Cause, Grade, VerdictFinding, combine_findings, judge

ROOT = Path(__file__).parents[3]
SOUND, REMARK, DOUBTFUL, BAD = Grade


def words_of(cause: Cause) -> dict[str, Any]:
    """Something for every further name in its sentence."""
    fields = Formatter().parse(cause.value.says)
    named = {name: spec for _, name, spec, _ in fields if name not in (None, "figure", "limit")}
    return {str(name): 0.25 if spec else "x" for name, spec in named.items()}


@pytest.mark.parametrize("cause", Cause)
def test_a_cause_counts_from_its_limits_on(cause: Cause) -> None:
    row = cause.value
    worse = -1.0 if row.falls else 1.0
    limits = {REMARK: row.remark, DOUBTFUL: row.doubtful, BAD: row.bad}
    found = [(limit, grade) for grade, limit in limits.items() if not math.isnan(limit)]
    assert found == sorted(found, key=lambda pair: worse * pair[0]), "limits get worse"
    before = SOUND
    for limit, grade in found:
        inside, beyond = (limit + side * worse * 1e-9 for side in (-1.0, 1.0))
        assert row.grade(inside) == before
        assert row.grade(beyond) == grade
        assert row.grade(limit) == (before if row.falls else grade)
        before = grade
    assert row.grade(worse * np.inf) == before and row.grade(-worse * np.inf) == SOUND
    assert [f.grade for f in judge(cause, worse * 1e9, **words_of(cause))] == [before]
    assert judge(cause, -worse * 1e9, **words_of(cause)) == []


@pytest.mark.parametrize("cause", Cause)
def test_a_cause_stands_in_the_manual_with_its_limits(cause: Cause) -> None:
    page = (ROOT / "docs" / "quality.md").read_text().split("## Reasons")[1].split("\n\n")[1]
    rows = [line.split("|")[2:4] for line in page.splitlines()[2:]]
    row = cause.value
    if cause is Cause.CAMERA_PLACE:
        assert any("half a cell" in doubtful for doubtful, _ in rows)
        return
    wanted = []
    for limit in (row.doubtful, row.bad):
        text = f"{limit:g}" if "{limit:g}" in row.says else to_percent(limit)
        text = "below " * row.falls + text if "{limit" in row.says else "yes"
        wanted.append("" if math.isnan(limit) else text)
    assert any(all(text in told for text, told in zip(wanted, one, strict=True)) for one in rows)


def test_a_finding_tells_its_figure_and_the_limit_from_which_it_counts() -> None:
    (found,) = judge(Cause.SATURATED, 0.2, shot="white")
    assert found.grade == BAD
    assert found.text.startswith("shot white: 20 % of the field is saturated (limit 0.2 %); ")
    (found,) = judge(Cause.NO_LIGHT, 2.5, shot="a")
    assert "its mean is 2.5 times its error (limit 5)" in found.text
    (found,) = judge(Cause.ERROR_BARS, np.inf, why="")
    assert "off by as much as all that it shows (RMS" in found.text
    (found,) = judge(Cause.EXPOSURE_TIMES, 2, shots="shot a", conflict="it took long")
    assert found.text.startswith("shot a: it took long (limit the larger of 1.1 s and 25 %); ")


def test_what_more_than_a_figure_decides_is_said_by_the_grade() -> None:
    (found,) = judge(Cause.MASK_PLACE, 0.0, BAD, **words_of(Cause.MASK_PLACE))
    assert found.grade == BAD and "0 % of the answer" in found.text
    assert judge(Cause.MASK_PLACE, 9.0, SOUND, **words_of(Cause.MASK_PLACE)) == []


def test_the_worst_finding_decides_and_comes_first() -> None:
    found = [VerdictFinding(REMARK, "r"), VerdictFinding(DOUBTFUL, "d"), VerdictFinding(BAD, "b")]
    made = combine_findings(found)
    assert (made.verdict, made.reasons, made.remarks) == ("bad", ("b", "d"), ("r",))
    assert combine_findings(found[:2]).verdict == "doubtful"
    alone = combine_findings(found[:1])
    assert (alone.verdict, alone.reasons, alone.remarks) == ("good", (), ("r",))
    assert combine_findings([]).verdict == "good"
