"""Where quads lie among cells: by hand, and one way of working it out against the other."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.panels.map import Map
from pdcd.sensor.quad_places import (
    PlaceNodes,
    compute_quad_places,
    find_upright_axes,
    interpolate_between_cells,
    make_axis_weights,
)
from tests.unit.panels.test_map import bent

FULL = Map.filling((6, 4))
RNG = np.random.default_rng(2)


def flat(*rows: tuple[float, float, float]) -> Map:
    """The map of a frame of 6 x 4 quads by its homography."""
    return FULL.then(np.array(rows))


SWAPPED = flat((0, 1, 0), (1, 0, 0), (0, 0, 1))
MIRRORED = flat((-1, 0, 1), (0, 1, 0), (0, 0, 1))


def test_the_lines_of_an_upright_frame() -> None:
    """Start and step in cells: down along rows of quads, right along columns."""
    assert find_upright_axes(FULL, (8, 3)) == (False, ((0.0, 2.0), (0.0, 0.5)))
    assert find_upright_axes(MIRRORED, (8, 3)) == (False, ((0.0, 2.0), (3.0, -0.5)))
    assert find_upright_axes(flat((2, 0, 0.5), (0, 3, 0.25), (0, 0, 1)), (8, 3)) == (
        False, ((2.0, 6.0), (1.5, 1.0)),
    )  # fmt: skip
    assert find_upright_axes(flat((2, 0, 1), (0, 4, 2), (0, 0, 2)), (8, 3)) == (
        False, ((8.0, 4.0), (1.5, 0.5)),
    )  # fmt: skip


@pytest.mark.parametrize(
    "change", [{"radial": (0.01, 0.0)}, {"residual": (((0.0, 0.0),) * 2,) * 2}]
)
def test_a_frame_seen_through_a_lens_is_not_upright(change: dict[str, Any]) -> None:
    map_ = msgspec.structs.replace(FULL, **change)
    assert find_upright_axes(map_, (8, 3)) is None
    assert make_axis_weights(map_, (4, 6), (8, 3)) is None


@pytest.mark.parametrize("at", [(0, 1), (1, 0), (2, 0), (2, 1)])
def test_a_turn_that_is_rounding_is_none(at: tuple[int, int]) -> None:
    for turn, same in ((1e-12, True), (-1e-12, True), (1e-6, False), (-1e-6, False)):
        numbers = np.diag([1 / 6, 1 / 4, 1.0])
        numbers[at] += turn
        map_ = Map(size_px=(6, 4), homography=tuple(numbers.ravel().tolist()))
        assert (find_upright_axes(map_, (8, 3)) is not None) is same, turn


@pytest.mark.parametrize("size", [(200, 140), (64, 65), (2, 3), (1, 1), (560, 420)])
def test_places_are_those_of_the_map(size: tuple[int, int]) -> None:
    """Worked out at some quads: at all of up to 64 a side, at every eighth of many."""
    map_ = bent(4, size_px=size)
    frame, grid = (size[1], size[0]), (30, 40)
    exact = map_.centres() * (40, 30) - 0.5
    found = compute_quad_places(map_, frame, grid)
    few = max(size) <= 64
    np.testing.assert_allclose(np.moveaxis(found, 0, -1), exact, atol=2e-5 if few else 2e-2)
    nodes = PlaceNodes(map_, frame, grid)
    rows = slice(frame[0] // 3, frame[0])
    x, y = nodes.places(rows)
    np.testing.assert_allclose(x, exact[rows, :, 0] + 0.5, atol=1e-9 if few else 2e-2)
    np.testing.assert_allclose(y, exact[rows, :, 1] + 0.5, atol=1e-9 if few else 2e-2)


def test_the_slopes_of_quads_are_those_of_the_map() -> None:
    map_ = bent(4, size_px=(50, 40))
    nodes = PlaceNodes(map_, (40, 50), (3, 8))
    x, y = np.meshgrid(np.arange(50) + 0.5, np.arange(40) + 0.5)
    exact = map_.jacobian(np.stack([x, y], axis=-1))[10:20] * np.array([[8], [3]])
    (a, b), (c, d) = nodes.slopes(slice(10, 20))
    for found, (row, col) in ((a, (0, 0)), (b, (0, 1)), (c, (1, 0)), (d, (1, 1))):
        np.testing.assert_allclose(found, exact[..., row, col], atol=1e-12)


def test_quads_beyond_infinity_lie_far_away() -> None:
    # The horizon is where x = 4.5; the frame's centre lies on this side.
    map_ = Map(size_px=(6, 4), homography=(1, 0, 0, 0, 1, 0, -1 / 4.5, 0, 1))
    found = compute_quad_places(map_, (4, 6), (8, 3))
    assert (found[0, :, 5] == -3000.5).all() and (found[1, :, 5] == -8000.5).all()
    assert (found[:, :, :4] > -1.0).all()
    (a, _), _ = PlaceNodes(map_, (4, 6), (8, 3)).slopes(slice(0, 4))
    assert (a[:, 5] == 0.0).all() and np.isfinite(a).all()


@pytest.mark.parametrize(
    "map_",
    [
        FULL,
        MIRRORED,
        SWAPPED,
        flat((2, 0, -1), (0, 3, 1), (0, 0, 1)),
        flat((0.4, 0, 0), (0, 0.4, 0), (0, 0, 1)),
    ],
)
@pytest.mark.parametrize("grid", [(8, 3), (1, 1), (3, 8), (2, 1)])
def test_both_ways_between_cells_agree(map_: Map, grid: tuple[int, int]) -> None:
    lines = make_axis_weights(map_, (4, 6), grid)
    assert lines is not None
    turned, down, right = lines
    values = RNG.random(grid).astype(np.float32)
    table = values if not turned else values.T
    found = down @ (right @ table.T).T
    np.testing.assert_allclose(down.sum(axis=1), 1.0)
    np.testing.assert_allclose(right.sum(axis=1), 1.0)
    assert down.nnz <= 2 * 4 and (down.data > 0.0).all()
    wanted = interpolate_between_cells(values, compute_quad_places(map_, (4, 6), grid))
    np.testing.assert_allclose(found, wanted, atol=0.02)  # OpenCV counts in 32nds of a pixel
