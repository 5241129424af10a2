"""What a plan says of the codes of depths, against what its patterns do."""

from __future__ import annotations

import re
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import Config, RigConfig, ScheduleConfig
from pdcd.panels.patterns import read_pattern_levels
from pdcd.planning.make import make_plan
from pdcd.planning.plan import Plan
from pdcd.protocol.request import CaptureRequest
from pdcd.words import WindowName

ROWS = 4


def planned(columns: int, window: WindowName = "whole", **fields: Any) -> Plan:
    rig = Config(rig=RigConfig(arrangement="off-axis"), schedule=ScheduleConfig(window=window))
    return make_plan(msgspec.convert(fields, CaptureRequest), rig, (ROWS, columns))


def said(plan: Plan) -> str:
    """What it says of its codes, without the first word."""
    (text,) = (reason for reason in plan.reasons if reason.startswith("codes: "))
    return text.removeprefix("codes: ")


def on_both(
    plan: Plan, program: str, cells: tuple[int, int] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Levels of projector and mask, (K, rows, columns) each."""
    rows, columns = cells or plan.grid
    projector, mask = (
        np.array([read_pattern_levels(side, k, rows * columns) for k in range(len(side))])
        for side in plan.patterns[program]
    )
    return projector.reshape(-1, rows, columns), mask.reshape(-1, rows, columns)


@pytest.mark.parametrize("codes", [4, 8, 16])
@pytest.mark.parametrize("columns", [9, 12, 16])
def test_cells_of_a_row_that_share_a_code_are_as_far_apart_as_it_says(
    codes: int, columns: int
) -> None:
    """Of the cells of codes: under windows there is one more in each row."""
    plan = planned(columns, "quarter", goal="keyed", codes=codes)
    lit = on_both(plan, "keyed", (ROWS + 1, columns + 1))[0]
    alike = (lit[:, :, :, None] == lit[:, :, None, :]).all(axis=0)
    apart = np.abs(np.subtract.outer(np.arange(columns + 1), np.arange(columns + 1)))
    shared = np.broadcast_to(apart, alike.shape)[alike & (apart > 0)]
    words = said(plan)
    assert words.endswith(" share a code: other depths stay as they are")
    nearest = re.search(r"row none nearer than (\d+) cells share", words)
    if nearest is None:
        assert "row none share" in words and not shared.size
    else:
        least = int(nearest.group(1))
        assert shared.min(initial=least) == least and columns >= least
        assert columns < 2 * codes or shared.min() == least


@pytest.mark.parametrize("codes", [16, 20])
@pytest.mark.parametrize("columns", [8, 13, 14, 17, 18, 30])
@pytest.mark.parametrize("low", [-1, 2])
def test_a_comb_that_blocks_other_depths_says_so(codes: int, columns: int, low: int) -> None:
    """Closed for two disparities: a comb that is too short comes back while they are closed."""
    plan = planned(columns, goal="keyed", codes=codes, disparity=[low, low + 1])
    lit, opened = on_both(plan, "keyed")
    paths = np.einsum("kyn,kym->ynm", opened, lit)  # of a row: n sees, m is lit
    ahead = np.subtract.outer(np.arange(columns), np.arange(columns)).T  # m - n
    asked = (ahead == low) | (ahead == low + 1)
    assert not paths[:, asked].any()
    others_too = bool((paths[:, ~asked] == 0).any())
    words = said(plan)
    told = re.search(r"; depths that are (\d+) cells apart are blocked together", words)
    # Combs that are one or two short block nothing else yet in whole cells, but under windows.
    assert told is not None or not others_too
    assert (told is not None) == (codes < columns + 3)
    period = int(re.findall(r"a comb of period (\d+), closed for 2 disparities", words)[0])
    assert told is None or int(told.group(1)) == period
    share = float(re.findall(r"; (\S+) % of the light", words)[0])
    shown = lit[: len(lit) - len(lit) % period]  # whole combs
    assert share == pytest.approx(100.0 * shown.mean(), rel=0.05)


@pytest.mark.parametrize(
    ("codes", "window", "words"),
    [
        (2, "whole", "one for each row, 2 codes for 4 rows are not exact"),
        (4, "whole", "one for each row, exact"),
        (8, "whole", "one for each row, exact"),
        (8, "quarter", "one for each row, exact; windows see half of the next rows with each row"),
    ],
)
def test_codes_of_rows_are_exact_where_each_row_has_its_own(
    codes: int, window: WindowName, words: str
) -> None:
    plan = planned(10, window, goal="epipolar", codes=codes)
    assert said(plan) == words
    if window == "whole":
        lit, opened = on_both(plan, next(iter(plan.recipe.programs)))
        met = np.einsum("kyn,kzm->yz", opened, lit)
        others = met[~np.eye(ROWS, dtype=bool)]
        assert (np.ptp(others) == 0.0) == words.endswith("row, exact")


def test_other_goals_have_no_depths_to_speak_of() -> None:
    plan = planned(10, goal="indirect", codes=8)
    assert not any("comb" in reason or "row" in reason for reason in plan.reasons)
