"""Up to which numbers a map is sound, and cells in pixels of a device."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.map import Map
from pdcd.panels.map_soundness import (
    check_map,
    check_share,
    compute_field_share,
    find_fewest_pixels,
    find_points_on_device,
    is_field_covered,
)

GOOD = Map.filling((64, 48))


def refused(says: str, size_px: tuple[int, int] = (64, 48), **change: Any) -> ConfigError:
    map_ = msgspec.structs.replace(Map.filling((64, 48)), size_px=size_px, **change)
    with pytest.raises(ConfigError, match=says) as caught:
        check_map(map_, "camera")
    assert caught.value.message.startswith("the map of the camera ")
    assert caught.value.device == "camera" and "calibrate" in (caught.value.hint or "")
    return caught.value


@pytest.mark.parametrize("size", [(1, 1), (1, 2**16), (2**16, 1), (2**16, 2**16)])
def test_a_device_of_1_to_65536_pixels_a_side(size: tuple[int, int]) -> None:
    map_ = Map.filling(size)
    assert check_map(map_, "mask") is map_


@pytest.mark.parametrize("size", [(0, 48), (64, 0), (-64, 48), (64, -1), (65537, 48), (64, 65537)])
def test_a_device_of_no_pixels_or_too_many(size: tuple[int, int]) -> None:
    refused(f"has {size[0]} x {size[1]} pixels; 1 to 65536 a side are read", size)


@pytest.mark.parametrize("share_px", [1.0, -1.0])
def test_a_corner_lies_a_hundred_fields_away_at_most(share_px: float) -> None:
    far = Map(size_px=(4, 4), homography=(25.0 * share_px, 0, 0, 0, 25.0, 0, 0, 0, 1))
    assert check_map(far, "mask") is far
    more = Map(size_px=(4, 4), homography=(25.5 * share_px, 0, 0, 0, 25.0, 0, 0, 0, 1))
    with pytest.raises(ConfigError, match="places a corner 102 fields away"):
        check_map(more, "mask")


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_each_number_is_finite(number: float) -> None:
    for change in (
        {"homography": (number, *GOOD.homography[1:])},
        {"homography": (*GOOD.homography[:8], number)},
        {"radial": (0.0, number)},
        {"tangential": (number, 0.0)},
    ):
        refused("has numbers that are not finite", **change)
    refused(
        "has a residual that is not finite",
        residual=(((0.0, 0.0), (0.0, number)), ((0.0, 0.0), (0.0, 0.0))),
    )


def still(rows: int, cols: int) -> tuple[tuple[tuple[float, float], ...], ...]:
    return (((0.0, 0.0),) * cols,) * rows


def test_a_residual_has_2_to_32_nodes_a_side() -> None:
    for rows, cols in ((2, 2), (2, 32), (32, 2), (32, 32)):
        map_ = msgspec.structs.replace(GOOD, residual=still(rows, cols))
        assert check_map(map_, "mask") is map_
    says = "has a residual that is no grid of 2 x 2 to 32 x 32 nodes"
    for rows, cols in ((1, 2), (2, 1), (33, 2), (2, 33), (1, 1)):
        refused(says, residual=still(rows, cols))
    wrongs: tuple[Any, ...] = (
        (((0.0, 0.0, 0.0),) * 2,) * 2,
        ((0.0, 0.0), (0.0, 0.0)),
        (((0.0, 0.0),) * 2, ((0.0, 0.0),) * 3),
        (((0.0, "x"),) * 2,) * 2,
        (((0.0, None),) * 2, ((0.0, {}),) * 2),
    )
    for wrong in wrongs:
        refused(says, residual=wrong)


def test_a_fold_between_many_nodes_is_seen() -> None:
    """One node of 32 that leaps over its neighbour: so narrow a fold lies between 33 points a
    side, and is met by four from each node to the next."""
    nodes = [[(0.0, 0.0)] * 32 for _ in range(32)]
    nodes[16][16] = (2.0, 0.0)
    refused("folds", residual=tuple(map(tuple, nodes)))


def test_a_device_turned_around_by_its_residual_cannot_be_inverted() -> None:
    around = (((64.0, 48.0), (-64.0, 48.0)), ((64.0, -48.0), (-64.0, -48.0)))
    refused("cannot be inverted over the whole device", residual=around)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_part_of_it_folded_is_folded(mirror: float) -> None:
    """A fold at the corners only, of a device that is mirrored or not."""
    map_ = GOOD.then([[mirror, 0.0, 0.5 - 0.5 * mirror], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    # The straight distance grows up to r = sqrt(1 / (3 0.125)) = 1.63; corners are at 1.67.
    folded = msgspec.structs.replace(map_, radial=(-0.125, 0.0))
    with pytest.raises(ConfigError, match="folds: some places of the field have two pixels"):
        check_map(folded, "mask")
    flat = msgspec.structs.replace(map_, radial=(-0.115, 0.0))  # up to 1.70
    assert check_map(flat, "mask") is flat


def beside(right: float, down: float) -> Map:
    return GOOD.then([[1.0, 0.0, right], [0.0, 1.0, down], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("map_", "covered"),
    [
        (GOOD, 1.0),
        (beside(0.5, 0.0), 0.5),
        (beside(-0.25, 0.0), 0.75),
        (beside(0.0, 0.75), 0.25),
        (beside(0.5, -0.5), 0.25),
        (beside(1.5, 0.0), 0.0),
        (beside(0.5 / 64, 0.0), 1.0),  # the first points lie on the device's edge
        (beside(-0.5 / 64, 0.0), 1.0),
        (beside(0.6 / 64, 0.0), 63 / 64),
        (beside(-0.6 / 64, 0.0), 63 / 64),
        (GOOD.then(np.diag([2.0, 2.0, 1.0])), 1.0),
    ],
)
def test_the_share_of_the_field_that_a_device_covers(map_: Map, covered: float) -> None:
    assert compute_field_share(map_) == pytest.approx(covered, abs=1e-12)


def test_a_panel_covers_a_quarter_at_least() -> None:
    quarter = beside(0.5, -0.5)
    assert check_share(quarter, "mask") is quarter
    less = GOOD.then(np.diag([0.5, 15.0 / 32.0, 1.0]))
    with pytest.raises(ConfigError) as caught:
        check_share(less, "mask")
    assert caught.value.message == (
        "the map of the mask covers 23.4% of the field only; 25% at least are needed"
    )
    assert check_share(less, "mask", least=0.2) is less
    with pytest.raises(ConfigError, match="places it beside the field"):
        check_share(beside(1.5, 0.0), "mask")


FULL = Map.filling((64, 48))
NARROWING = FULL.then([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.0, 0.5]])
"""A step of a pixel leads ever less far across, four times less at the right edge."""


def moved(right: float, down: float) -> Map:
    """The device that fills the field, shifted by so many of its pixels."""
    return FULL.then([[1.0, 0.0, right / 64], [0.0, 1.0, down / 48], [0.0, 0.0, 1.0]])


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
