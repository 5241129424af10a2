"""Matches of cells by depth, by shift and by warp: places, edges of the grid, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.protocol.plan_summary import Goal
from pdcd.recipes.partners import (
    NO_MATCH,
    PARTNER_GUARD_CELLS,
    check_depths,
    describe_partners,
    extend_places,
    find_match_places,
    find_matched_cells,
    link_partners,
    list_distant_partners,
    list_partner_cells,
)
from pdcd.recipes.programs import (
    CodedProgram,
    IlluminatedProgram,
    LongRangeProgram,
    SignedMatrixProgram,
    SignedProgram,
)

GRID = (3, 5)
N = 15
SAME = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
DOWN, RIGHT = np.array([1, 0]), np.array([0, 1])
HERE = np.stack(np.divmod(np.arange(N), 5), axis=1)


def keyed(**numbers: Any) -> Goal:
    return Goal(name="keyed", **numbers)


def test_places_without_depths_are_the_cells_themselves() -> None:
    np.testing.assert_array_equal(find_match_places(keyed(), GRID, {}), HERE)
    np.testing.assert_array_equal(find_match_places(keyed(plane=SAME), GRID, {}), HERE)


def test_a_plane_moves_places_by_its_homography() -> None:
    """Two fifths to the right, a third down."""
    moved = (1.0, 0.0, 0.4, 0.0, 1.0, 1.0 / 3.0, 0.0, 0.0, 1.0)
    np.testing.assert_array_equal(
        find_match_places(keyed(plane=moved), GRID, {}), HERE + DOWN + 2 * RIGHT
    )
    back = (1.0, 0.0, -0.4, 0.0, 1.0, -1.0 / 3.0, 0.0, 0.0, 1.0)
    np.testing.assert_array_equal(
        find_match_places(keyed(plane=back), GRID, {}), HERE - DOWN - 2 * RIGHT
    )
    with pytest.raises(RequestError, match="plane: "):
        find_match_places(keyed(plane=(0.0,) * 9), GRID, {})


def test_disparities_count_cells_to_the_right_from_the_middle_of_each() -> None:
    disparities = np.zeros(N)
    disparities[:6] = 0.49, 0.5, -0.5, -0.51, 2.6, 1e30
    row, col = find_match_places(keyed(), GRID, {"disparities": disparities}).T
    np.testing.assert_array_equal(row, HERE[:, 0])
    np.testing.assert_array_equal(col[:5], [0, 2, 2, 2, 7])
    assert col[5] >= 10**8
    np.testing.assert_array_equal(col[6:], HERE[6:, 1])


def test_a_warp_names_cells_or_none() -> None:
    warp = np.arange(N)[::-1].astype(float)
    warp[3] = -1.0
    found = find_match_places(keyed(), GRID, {"warp": warp})
    assert found[3].tolist() == [NO_MATCH, NO_MATCH]
    assert found[0].tolist() == [2, 4] and found[14].tolist() == [0, 0]
    assert (find_matched_cells(found, 0, GRID) == warp).all()


def test_matches_end_where_the_grid_does() -> None:
    place = np.array([[0, 0], [2, 4], [-1, 0], [3, 0], [1, -1], [1, 5], [1, 2]])
    assert find_matched_cells(place, 0, GRID).tolist() == [0, 14, -1, -1, -1, -1, 7]
    assert find_matched_cells(place, 1, GRID).tolist() == [1, -1, -1, -1, 5, -1, 8]
    assert find_matched_cells(place, -2, GRID).tolist() == [-1, 12, -1, -1, -1, 8, 5]


def test_places_go_on_over_the_far_edges() -> None:
    found = extend_places(HERE, Lattice(GRID, "quarter")).reshape(4, 6, 2)
    for row in range(4):
        for col in range(6):
            assert found[row, col].tolist() == [row, col]


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


def test_disparity_0_is_told_once() -> None:
    flat = {"disparities": np.zeros(N)}
    check_depths(keyed(), GRID, flat)
    check_depths(keyed(plane=SAME), GRID, {})
    with pytest.raises(RequestError, match="both plane and disparities say"):
        check_depths(keyed(plane=SAME), GRID, flat)
    with pytest.raises(RequestError, match="both disparities and warp say"):
        check_depths(keyed(), GRID, {**flat, "warp": np.zeros(N)})


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


def test_partners_are_far_beyond_the_reach_in_rows_or_columns() -> None:
    grid = (9, 9)
    near, far = (0, PARTNER_GUARD_CELLS), (0, -PARTNER_GUARD_CELLS - 1)
    assert PARTNER_GUARD_CELLS == 3
    assert list_distant_partners(CodedProgram(near, True), grid) == ()
    assert list_distant_partners(CodedProgram(far, True), grid) == (far,)
    assert list_distant_partners(CodedProgram((4, 0), True), grid) == ((4, 0),)
    assert (
        list_distant_partners(CodedProgram(None, True), grid)
        == ()
        == list_distant_partners(LongRangeProgram(1), grid)
    )
    assert list_distant_partners(
        IlluminatedProgram(CodedProgram(far, True), np.ones(81)), grid
    ) == (far,)
    assert list_distant_partners(
        SignedProgram(((1.0, far), (1.0, None), (1.0, near)), True), grid
    ) == (far,)
    warp = np.full(81, -1)
    warp[40] = 40 + 27 + 3
    assert list_distant_partners(SignedMatrixProgram(np.eye(81), True, (warp,)), grid) == ()
    warp[0] = 4
    (found,) = list_distant_partners(SignedMatrixProgram(np.eye(81), True, (warp,)), grid)
    assert found is warp
    warp[0], warp[80] = -1, 80 - 36
    assert len(list_distant_partners(SignedMatrixProgram(np.eye(81), True, (warp,)), grid)) == 1


def test_codes_of_partners_are_linked_with_the_light_around_a_cell() -> None:
    lattice = Lattice((9, 9))
    assert link_partners((), lattice) is None
    warp = np.full(81, -1)
    warp[40] = 8
    links = link_partners((warp,), lattice)
    assert links is not None
    dense = links.toarray()
    np.testing.assert_array_equal(dense, dense.T)
    row = dense[8] / dense[8, 40]
    for cell in range(81):
        down, right = cell // 9 - 4, cell % 9 - 4
        near = max(abs(down), abs(right)) <= 3
        if cell == 40:
            continue
        wanted = 0.25 / (down**2 + right**2) if near else 0.0
        assert row[cell] == pytest.approx(wanted)
    assert np.count_nonzero(dense) == 2 * 49 and np.count_nonzero(dense[8]) == 49
