"""Realised matrices added, divided and compared: small ones, against their entries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pdcd.probing.deviation import measure_deviation, weight_s
from pdcd.probing.fine import PieceWeights
from pdcd.probing.realised import (
    Factors,
    collect_factors,
    divide_factors,
    sum_arrays,
    sum_signed_factors,
)
from pdcd.probing.wanted import (
    GainPart,
    MatchPart,
    NearPart,
    UniformPart,
    WantedMatrix,
    shift_cells,
)
from tests import bench_rig

GRID = (3, 4)
CELLS = 12
OFF = ~np.eye(CELLS, dtype=bool)


def some(seed: int, *, rank: int = 5, cells: int = CELLS, fine: bool = False) -> Factors:
    rng = np.random.default_rng(seed)
    left, right = rng.random((2, rank, cells))
    parts = PieceWeights(((0.0, 1.0), (0.0, 1.0)), True, *rng.random((3, *GRID))) if fine else None
    return Factors(left, right, rng.random(cells), rng.random(cells), parts)


def test_chunks_add_up() -> None:
    parts = [some(seed, fine=True) for seed in range(3)]
    whole = collect_factors(parts)
    np.testing.assert_allclose(whole.dense(), sum(part.dense() for part in parts))
    np.testing.assert_allclose(whole.coaxial, sum_arrays(part.coaxial for part in parts))
    np.testing.assert_allclose(whole.open_s, sum_arrays(part.open_s for part in parts))
    assert whole.fine is not None and whole.displaced is None
    light = [part.fine.light for part in parts if part.fine is not None]
    np.testing.assert_allclose(whole.fine.light, sum(light))
    assert len(whole.left) == CELLS  # three times five rows are more than there are cells
    assert collect_factors([parts[0], replace(parts[1], fine=None)]).fine is None
    assert collect_factors(some(seed) for seed in range(3)).fine is None


def test_a_photo_that_was_divided_has_a_share_of_its_matrix() -> None:
    one = some(2, fine=True)
    third = divide_factors(one, 3.0)
    np.testing.assert_allclose(third.dense(), one.dense() / 3.0)
    np.testing.assert_allclose(third.coaxial, one.coaxial / 3.0)
    np.testing.assert_allclose(third.open_s, one.open_s / 3.0)
    assert third.fine is not None and one.fine is not None
    np.testing.assert_allclose(third.fine.coaxial, one.fine.coaxial / 3.0)
    assert divide_factors(some(2), 3.0).fine is None


def test_photos_are_added_and_taken_off() -> None:
    one, other = some(3, fine=True), some(4, rank=2, fine=True)
    total = sum_signed_factors([(1.0, one), (-0.5, other)])
    np.testing.assert_allclose(total.dense(), one.dense() - 0.5 * other.dense())
    np.testing.assert_allclose(total.coaxial, one.coaxial - 0.5 * other.coaxial)
    np.testing.assert_allclose(total.open_s, one.open_s - 0.5 * other.open_s)
    assert total.fine is not None and one.fine is not None and other.fine is not None
    np.testing.assert_allclose(total.fine.own, one.fine.own - 0.5 * other.fine.own)
    assert sum_signed_factors([(1.0, one)]) is one
    np.testing.assert_allclose(sum_signed_factors([(-1.0, one)]).dense(), -one.dense())


def test_direct_goals_are_scaled_by_their_direct_light() -> None:
    one = some(5)
    own = MatchPart(np.arange(CELLS))
    even = WantedMatrix(GRID, ((0.25, UniformPart(CELLS)), (1.75, own)), by_direct=True)
    assert weight_s(one, even) == pytest.approx(one.coaxial.mean() / 2.0)
    near = WantedMatrix(GRID, ((1.5, NearPart(GRID, 0)), (0.1, NearPart(GRID, 1))), by_direct=True)
    assert weight_s(one, near) == pytest.approx(one.coaxial.mean() / 1.6)
    # Under an illumination, and where nobody asks for it, all entries count.
    for wanted in (
        replace(near, light=np.linspace(0.5, 1.0, CELLS)),
        replace(near, by_direct=False),
        replace(even, by_direct=False),
    ):
        meant, dense = wanted.dense(), one.dense()
        np.fill_diagonal(dense, one.coaxial)
        assert weight_s(one, wanted) == pytest.approx((dense * meant).sum() / (meant**2).sum())


def test_matched_goals_are_scaled_by_what_matched_cells_got() -> None:
    one, partner = some(6), shift_cells(GRID, (0, 1))
    partner[5] = 5  # one cell matches itself: its light is direct
    wanted = WantedMatrix(
        GRID, ((0.75, MatchPart(partner)), (0.25, UniformPart(CELLS))), by_direct=True
    )
    there = np.flatnonzero(partner >= 0)
    dense = one.dense()
    np.fill_diagonal(dense, one.coaxial)
    got = dense[there, partner[there]].sum()
    assert weight_s(one, wanted) == pytest.approx(got / there.size)
    camera = np.linspace(1.0, 2.0, CELLS)
    gained = WantedMatrix(GRID, ((1.0, GainPart(camera, MatchPart(partner))),), by_direct=True)
    assert weight_s(one, gained) == pytest.approx(got / camera[there].sum())


def test_goals_by_light_are_scaled_by_all_light_but_the_direct() -> None:
    one = some(7)
    wanted = WantedMatrix(
        GRID, ((0.5, NearPart(GRID, 1)), (2.0, MatchPart(np.arange(CELLS)))), by_light=True
    )
    kept = one.dense()[OFF].sum()
    assert weight_s(one, wanted) == pytest.approx(kept / wanted.dense()[OFF].sum())


def test_a_goal_of_nothing_is_scaled_by_the_open_time() -> None:
    one = some(8)
    nothing = WantedMatrix(GRID, ((0.0, NearPart(GRID, 1)),))
    assert weight_s(one, nothing) == pytest.approx(one.open_s.mean())
    alone = Factors(np.ones((1, 1)), np.ones((1, 1)), np.ones(1), np.full(1, 7.0))
    assert weight_s(alone, bench_rig.uniform((1, 1), 0.0, 1.0)) == 7.0
    report = measure_deviation(alone, bench_rig.uniform((1, 1), 0.0, 1.0))
    assert (report.off_rms, report.off_max) == (0.0, 0.0)
    assert report.diagonal_mean == pytest.approx(1 / 7)


@pytest.mark.parametrize("apart", [0.0, 0.25])
def test_direct_light_of_borders_has_the_weight_of_other_paths(apart: float) -> None:
    one, wanted = some(9), bench_rig.uniform(GRID, 0.2, 1.0)
    report = measure_deviation(one, wanted, apart=apart)
    there = one.dense()[OFF].mean() / report.weight_s
    own = one.coaxial.mean() / report.weight_s
    assert report.diagonal_mean == pytest.approx((1.0 - apart) * own + apart * there - 0.2)
    assert report.diagonal_max == pytest.approx(np.abs(one.coaxial / report.weight_s - 0.2).max())
    # Other goals have no one weight for it.
    near = WantedMatrix(GRID, ((1.0, NearPart(GRID, 1)),))
    assert measure_deviation(one, near, apart=apart) == measure_deviation(one, near)


@pytest.mark.parametrize(("grid", "exact"), [((32, 32), True), ((25, 41), False)])
def test_the_largest_deviation_of_at_most_so_many_cells(grid: tuple[int, int], exact: bool) -> None:
    got = some(10, rank=1, cells=grid[0] * grid[1])
    report = measure_deviation(got, bench_rig.uniform(grid, 0.0, 1.0))
    assert (report.off_max is not None) is exact
    if report.off_max is not None:
        error = got.dense() / report.weight_s - 1.0
        np.fill_diagonal(error, 0.0)
        assert report.off_max == pytest.approx(np.abs(error).max())


def test_work_on_rows_can_be_ended() -> None:
    def enough() -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        measure_deviation(some(11), bench_rig.uniform(GRID, 0.0, 1.0), enough)
