"""Cells in pixels of a device: which are looked at, how large they are, whether all have any."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from pdcd.panels.map import Map
from pdcd.panels.map_soundness import (
    find_fewest_pixels,
    find_points_on_device,
    is_field_covered,
    measure_cell_sides,
)

FULL = Map.filling((64, 48))
NARROWING = FULL.then([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.0, 0.5]])
"""A step of a pixel leads ever less far across, four times less at the right edge."""


def moved(right: float, down: float) -> Map:
    """The device that fills the field, shifted by so many of its pixels."""
    return FULL.then([[1.0, 0.0, right / 64], [0.0, 1.0, down / 48], [0.0, 0.0, 1.0]])


def test_a_point_lies_on_the_device_up_to_its_edges() -> None:
    points = [[0.0, 0.0], [64.0, 48.0], [10.0, 20.0], [-0.01, 20.0], [64.01, 20.0], [20.0, -0.01],
              [20.0, 48.01], [60.0, 50.0], [np.nan, 20.0], [20.0, np.nan]]  # fmt: skip
    assert find_points_on_device(FULL, np.array(points)).tolist() == [True] * 3 + [False] * 7


def test_pixels_across_a_cell_are_counted_each_way() -> None:
    assert measure_cell_sides(FULL, np.array([[1.0, 2.0]]), (6, 4)) == pytest.approx((8.0, 16.0))
    assert measure_cell_sides(FULL, np.array([[1.0, 2.0]]), (2, 16)) == pytest.approx((4.0, 24.0))
    assert measure_cell_sides(FULL, np.empty((0, 2)), (6, 4)) == (0.0, 0.0)


def test_only_cells_on_the_device_are_counted() -> None:
    assert find_fewest_pixels(FULL, (6, 4)) == pytest.approx(8.0)
    assert find_fewest_pixels(moved(70.0, 0.0), (6, 4)) is None
    # Half a field to the right, cells at the left edge would be coarser and are not there. At
    # 0.625 of the field t is 1 / 15.
    beside = NARROWING.then([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    at = beside.from_field([[0.625, 0.125]])
    assert at[0, 0] == pytest.approx(64.0 / 15.0)
    found = find_fewest_pixels(beside, (4, 4))
    steepest = {
        x: max(
            np.linalg.norm(beside.jacobian(beside.from_field([x, y])), 2)
            for y in (0.125, 0.375, 0.625, 0.875)
        )
        for x in (0.375, 0.625)
    }
    assert found == pytest.approx(0.25 / steepest[0.625]) and steepest[0.375] > steepest[0.625]


@pytest.mark.parametrize(
    ("right", "down"), [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, -1.0)]
)
def test_a_device_may_end_half_a_pixel_within_the_field(right: float, down: float) -> None:
    square = Map.filling((64, 64))
    half = square.then([[1.0, 0.0, right / 128], [0.0, 1.0, down / 128], [0.0, 0.0, 1.0]])
    assert is_field_covered(half) and is_field_covered(square)
    assert is_field_covered(moved(0.49 * right, 0.49 * down))
    assert not is_field_covered(moved(0.51 * right, 0.51 * down))
    assert not is_field_covered(moved(0.9 * right, 0.9 * down))


def test_a_device_is_asked_all_along_the_border() -> None:
    """Corners pulled in, or one side bent away in its middle alone."""
    barrel = msgspec.structs.replace(FULL, radial=(-0.05, 0.0))
    larger = barrel.then([[1.1, 0.0, -0.05], [0.0, 1.1, -0.05], [0.0, 0.0, 1.0]])
    middles = larger.from_field([[0.5, 0.0], [0.5, 1.0], [0.0, 0.5], [1.0, 0.5]])
    assert find_points_on_device(larger, middles).all() and not is_field_covered(larger)
    assert is_field_covered(barrel.then([[1.3, 0.0, -0.15], [0.0, 1.3, -0.15], [0.0, 0.0, 1.0]]))
    still = (0.0, 0.0)
    for side in range(4):
        nodes = [[still] * 3 for _ in range(3)]
        row, col = [(0, 1), (2, 1), (1, 0), (1, 2)][side]
        nodes[row][col] = (-1.5 * (col - 1), -1.5 * (row - 1))
        bent = msgspec.structs.replace(FULL, residual=tuple(map(tuple, nodes)))
        assert not is_field_covered(bent), side
