"""Path isolation, and slices of the transport matrix: their exposures, and their limits."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.probing.wanted import MatchPart, UniformPart, WantedMatrix
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.isolation import (
    ISOLATION_FAMILIES,
    Isolation,
    check_isolation,
    use_path_isolation,
)
from pdcd.recipes.make import make_recipe
from pdcd.recipes.transport import Slice, check_slice, count_slice_photos


def all_but_own(cells: int) -> WantedMatrix:
    return WantedMatrix(
        (1, cells), ((1.0, UniformPart(cells)), (-1.0, MatchPart(np.arange(cells))))
    )


def test_isolation_has_a_slot_for_each_pair_that_counts() -> None:
    own = WantedMatrix((1, 300), ((2.0, MatchPart(np.arange(300))),))
    confocal = Isolation(own, True, True)
    assert confocal.count() == 300
    lit, opened = confocal.pairs(np.zeros((0, 300), np.bool_), Lattice((1, 300)))
    np.testing.assert_array_equal(lit, np.eye(300))
    np.testing.assert_array_equal(opened, np.eye(300))
    assert Isolation(own, True, False).count() == 300**2
    assert Isolation(all_but_own(3), True, True).count() == 6


@pytest.mark.parametrize(("positive", "sign"), [(True, 1.0), (False, -1.0)])
def test_both_halves_of_isolation_open_the_same_cells(positive: bool, sign: float) -> None:
    wanted = WantedMatrix(
        (1, 3), ((1.0, MatchPart(np.array([1, 2, 0]))), (-0.5, MatchPart(np.arange(3))))
    )
    lit, opened = Isolation(wanted, positive, True).pairs(
        np.zeros((0, 3), np.bool_), Lattice((1, 3))
    )
    dense = wanted.dense()
    np.testing.assert_allclose(opened.T.astype(float) @ lit, np.maximum(sign * dense, 0.0))
    assert opened.sum() == 6 and (opened.sum(axis=1) == 1).all()


def test_a_single_cell_has_nothing_to_isolate() -> None:
    none = Isolation(all_but_own(1), True, True)
    assert none.count() == 1
    lit, opened = none.pairs(np.zeros((0, 1), np.bool_), Lattice((1, 1)))
    assert lit.shape == opened.shape == (1, 1) and not lit.any() and not opened.any()


def test_isolation_takes_the_place_of_codes_and_has_its_limits() -> None:
    goal = Target(Goal(name="indirect"), (1, 5))
    recipe = make_recipe(goal, CaptureScheme(black_level="mask"))
    for family in ISOLATION_FAMILIES:
        (program,) = use_path_isolation(recipe, family).programs.values()
        assert isinstance(program, Isolation)
        assert (program.positive, program.confocal) == (True, family == "confocal")
    made = use_path_isolation(recipe, "isolation")
    check_isolation(made, slot_s=0.04, limit_s=1.0)
    with pytest.raises(RequestError, match="of 25 pairs of cells takes 1 s a photo"):
        check_isolation(made, slot_s=0.041, limit_s=1.0)
    large = use_path_isolation(
        make_recipe(Target(Goal(name="indirect"), (1, 369)), CaptureScheme()), "isolation"
    )
    with pytest.raises(RequestError, match="more memory than is sensible"):
        check_isolation(large, slot_s=1e-9, limit_s=1.0)
    less = use_path_isolation(
        make_recipe(Target(Goal(name="indirect"), (1, 368)), CaptureScheme()), "isolation"
    )
    check_isolation(less, slot_s=1e-9, limit_s=1.0)


def slice_of(rows: tuple[int, int] | None = None, masked: bool | None = None) -> Goal:
    return Goal(name="transport", rows=rows, masked=masked)


def test_photos_of_a_slice_are_an_order_less_one() -> None:
    """A column for each cell, one of ones, and four left over: of order 8, 12, 16, 20 ..."""
    wanted = {1: 7, 3: 7, 4: 11, 7: 11, 8: 15, 11: 15, 12: 19, 1019: 1023, 1020: 1031}
    assert {cells: count_slice_photos(cells) for cells in wanted} == wanted


def test_a_slice_has_its_rows_and_its_limit_of_photos() -> None:
    check_slice(slice_of((0, 2)), (3, 4))
    for row in (-1, 3):
        with pytest.raises(RequestError, match=f"there is no row {row} on a grid of 3 x 4"):
            check_slice(slice_of((0, row)), (3, 4))
    with pytest.raises(RequestError, match="leaves no row to mask"):
        check_slice(slice_of(masked=True), (3, 4))
    check_slice(slice_of((0, 0)), (1, 1019))
    with pytest.raises(RequestError, match="1020 projector cells take 1031 photos"):
        check_slice(slice_of((0, 0)), (1, 1020))
    check_slice(slice_of((0, 0)), (1, 507), 2)
    with pytest.raises(RequestError, match="508 projector cells take 1030 photos"):
        check_slice(slice_of((0, 0)), (1, 508), 2)
    assert Slice.of(slice_of((1, 0)), (2, 3)).lit.tolist() == [3, 4, 5]
    assert Slice.of(slice_of((1, 0)), (2, 3)).seen.tolist() == [0, 1, 2]
    assert Slice.of(slice_of(), (2, 3)).lit.tolist() == list(range(6))


@pytest.mark.parametrize(
    "how",
    [
        CaptureScheme(method="nayar"),
        CaptureScheme(codes=16, pilot=4),
        CaptureScheme(codes=16, parts=2),
    ],
)
def test_a_slice_is_taken_in_no_other_way(how: CaptureScheme) -> None:
    with pytest.raises(RequestError, match="photos of single patterns"):
        make_recipe(Target(slice_of((0, 1)), (2, 3)), how)
