"""Matches of cells by depth, by shift and by warp: rounding, descriptions, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.protocol.plan_summary import Goal
from pdcd.recipes.partners import (
    PARTNER_GUARD_CELLS,
    check_depths,
    describe_partners,
    find_match_places,
    list_distant_partners,
    list_partner_cells,
)
from pdcd.recipes.programs import (
    CodedProgram,
    IlluminatedProgram,
    LongRangeProgram,
    Program,
    SignedMatrixProgram,
    SignedProgram,
)

GRID = (3, 5)
N = 15
HERE = np.stack(np.divmod(np.arange(N), 5), axis=1)


def keyed(**numbers: Any) -> Goal:
    return Goal(name="keyed", **numbers)


def test_disparities_count_cells_to_the_right_from_the_middle_of_each() -> None:
    disparities = np.zeros(N)
    disparities[:6] = 0.49, 0.5, -0.5, -0.51, 2.6, 1e30
    row, col = find_match_places(keyed(), GRID, {"disparities": disparities}).T
    np.testing.assert_array_equal(row, HERE[:, 0])
    np.testing.assert_array_equal(col[:5], [0, 2, 2, 2, 7])
    assert col[5] >= 10**8
    np.testing.assert_array_equal(col[6:], HERE[6:, 1])


@pytest.mark.parametrize(
    ("low", "high", "sound"),
    [(0, 0, True), (-4, -4, True), (4, 4, True), (-5, -5, False), (5, 5, False), (1, 0, False),
     (-1, 2, True), (-2, 2, False), (-1, 3, False)],
)  # fmt: skip
def test_depths_leave_something_of_a_row(low: int, high: int, sound: bool) -> None:
    goal = keyed(disparity=(low, high))
    if sound:
        check_depths(goal, GRID, {})
        return
    with pytest.raises(RequestError, match="disparities from"):
        check_depths(goal, GRID, {})


def test_some_cell_must_have_a_match_at_some_depth() -> None:
    far = {"disparities": np.full(N, 5.0)}
    with pytest.raises(RequestError, match="no camera cell has a match"):
        check_depths(keyed(disparity=(0, 0)), GRID, far)
    check_depths(keyed(disparity=(-1, 0)), GRID, far)
    check_depths(keyed(disparity=(0, 0)), GRID, {"disparities": np.r_[0.0, np.full(N - 1, 9.0)]})
    # What is wrong with an array is said elsewhere.
    check_depths(keyed(), GRID, {"disparities": np.full(N - 1, 99.0)})
    check_depths(keyed(), GRID, {"disparities": np.full(N, np.nan)})
    check_depths(keyed(), GRID, {"warp": np.full(N, -1.0)})


def test_a_warp_that_is_a_shift_is_told_as_one() -> None:
    own = np.arange(N)
    assert describe_partners(own, GRID) is None
    beside = np.where(own % 5 < 4, own + 1, -1)
    assert describe_partners(beside, GRID) == (0, 1)
    below = np.where((own < 10) & (own % 5 > 1), own + 3, -1)
    assert describe_partners(below, GRID) == (1, -2)
    beside[7] = -1
    assert describe_partners(beside, GRID) is beside
    none = np.full(N, -1)
    assert describe_partners(none, GRID) is none
    for partner in (None, (0, 1), (1, -2)):
        cells = list_partner_cells(partner, GRID)
        assert describe_partners(cells, GRID) == partner
    assert list_partner_cells(below, GRID) is below


NEAR, FAR = (0, PARTNER_GUARD_CELLS), (0, -PARTNER_GUARD_CELLS - 1)
BESIDE = np.where(np.arange(81) == 40, 40 + 27 + 3, -1)
BELOW = np.where(np.arange(81) == 80, 80 - 36, -1)


@pytest.mark.parametrize(
    ("program", "count"),
    [
        (CodedProgram(NEAR, True), 0), (CodedProgram(FAR, True), 1), (CodedProgram(None, True), 0),
        (LongRangeProgram(1), 0), (IlluminatedProgram(CodedProgram(FAR, True), np.ones(81)), 1),
        (SignedProgram(((1.0, FAR), (1.0, None), (1.0, NEAR)), True), 1),
        (SignedMatrixProgram(np.eye(81), True, (BESIDE,)), 0),
        (SignedMatrixProgram(np.eye(81), True, (BESIDE, BELOW)), 1),
    ],
)  # fmt: skip
def test_partners_are_far_beyond_the_reach_in_rows_or_columns(program: Program, count: int) -> None:
    assert len(list_distant_partners(program, (9, 9))) == count
