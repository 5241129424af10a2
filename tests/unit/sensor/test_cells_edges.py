"""Cells and the quads that see them: shapes by hand, limits of what counts as seen, weights."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.errors import DecodeError
from pdcd.panels.map import Map
from pdcd.sensor.cells import CellMap
from tests.unit.panels.test_map import bent

RNG = np.random.default_rng(12)
BLOCKS = CellMap.block((2, 3), (4, 6))
FILLED = CellMap(grid=(2, 3), frame=(4, 6), map=Map.filling((6, 4)))
VALUES = RNG.random((6, 3))
IMAGE = RNG.random((4, 6, 2))


def shifted(right: float, down: float = 0.0) -> CellMap:
    """A frame of 12 x 4 quads over 6 x 2 cells, shifted by so many quads."""
    map_ = Map.filling((12, 4)).then(
        [[1.0, 0.0, right / 12], [0.0, 1.0, down / 4], [0.0, 0.0, 1.0]]
    )
    return CellMap(grid=(2, 6), frame=(4, 12), map=map_)


def test_blocks_divide_the_frame_both_ways() -> None:
    assert BLOCKS.blocks == (2, 2) and FILLED.blocks is None
    assert CellMap.block((2, 3), (2, 12)).blocks == (1, 4)
    assert CellMap(grid=(3, 3), frame=(4, 6)).blocks is None
    assert CellMap(grid=(2, 4), frame=(4, 6)).blocks is None
    for frame in ((5, 6), (4, 7), (0, 6), (4, 0)):
        with pytest.raises(DecodeError, match=r"cannot be cut into 2 x 3 cells") as caught:
            CellMap.block((2, 3), frame)
        assert caught.value.device == "camera" and "scene.grid" in (caught.value.hint or "")


@pytest.mark.parametrize("cells", [BLOCKS, FILLED])
def test_a_frame_of_blocks_is_the_same_with_its_map(cells: CellMap) -> None:
    wide = VALUES.reshape(2, 3, 3).repeat(2, axis=0).repeat(2, axis=1)
    np.testing.assert_allclose(cells.spread(VALUES), wide, rtol=1e-14)
    np.testing.assert_allclose(cells.spread(VALUES[:, 0]), wide[..., 0], rtol=1e-14)
    means = IMAGE.reshape(2, 2, 3, 2, 2).mean(axis=(1, 3)).reshape(6, 2)
    np.testing.assert_allclose(cells.mean(IMAGE), means, rtol=1e-14)
    # Four independent quads each: the root of the sum of their variances, over four.
    sums = IMAGE.reshape(2, 2, 3, 2, 2).sum(axis=(1, 3)).reshape(6, 2)
    np.testing.assert_allclose(cells.error_of_mean(IMAGE), np.sqrt(sums) / 4.0, rtol=1e-12)
    assert cells.known.all() and cells.single.all() and cells.seen().all()
    assert cells.inside is None
    assert cells.centres[1, 2].tolist() == pytest.approx([2.5 / 6, 1.5 / 4])
    assert cells.filled == Map.filling((6, 4))
    np.testing.assert_allclose(cells.gather(VALUES.reshape(2, 3, 3)), wide, rtol=1e-14)


@pytest.mark.parametrize("cells", [BLOCKS, FILLED])
def test_unknown_quads_do_not_count(cells: CellMap) -> None:
    known = np.ones((4, 6), np.bool_)
    known[0, :2] = False  # half of the first cell
    known[2:, 4:] = False  # all of the last
    image = np.where(known[..., None], IMAGE, np.nan)
    means = np.nanmean(image[:, :4].reshape(2, 2, 2, 2, 2), axis=(1, 3))
    found = cells.mean(image, known).reshape(2, 3, 2)
    np.testing.assert_allclose(found[:, :2], means, rtol=1e-12)
    assert found[1, 2].tolist() == [0.0, 0.0]
    error = cells.error_of_mean(image, known).reshape(2, 3, 2)
    np.testing.assert_allclose(error[0, 0], np.sqrt(IMAGE[1, :2].sum(axis=0)) / 2.0, rtol=1e-12)
    assert error[1, 2].tolist() == [0.0, 0.0]
    assert cells.seen(known).tolist() == [False, True, True, True, True, False]


def test_of_a_cell_nine_tenths_are_known_or_it_is_not() -> None:
    cells = CellMap.block((1, 2), (5, 4))  # ten quads a cell
    known = np.ones((5, 4), np.bool_)
    known[0, 0] = False
    assert cells.seen(known).tolist() == [True, True]
    known[1, 0] = False
    assert cells.seen(known).tolist() == [False, True]


@pytest.mark.parametrize(("share", "seen"), [(0.06, True), (0.04, False), (0.0, False)])
def test_of_a_cell_a_twentieth_is_seen_or_nothing(share: float, seen: bool) -> None:
    """Quads a hundredth of a cell wide; the frame ends so far within the last cell."""
    width = 300
    map_ = Map.filling((width, 1))
    wide = map_.then(np.diag([(2.0 + share) / 3.0, 1.0, 1.0]))
    cells = CellMap(grid=(1, 3), frame=(1, width), map=wide)
    assert cells.seen().tolist() == [True, True, seen]


def test_a_frame_beside_the_field_sees_part_of_it() -> None:
    cells = shifted(2.0, 2.0)
    assert cells.known[:2, :10].all() and cells.known.sum() == 20
    assert cells.seen().reshape(2, 6).tolist() == [[False] * 6, [False] + [True] * 5]
    values = np.arange(12.0)
    seen = cells.spread(values)
    assert seen[0].tolist() == [7, 7, 8, 8, 9, 9, 10, 10, 11, 11, 0, 0] and not seen[2:].any()
    back = cells.mean(seen[..., None])[:, 0]
    assert back.tolist() == [0.0] * 7 + [7.0, 8.0, 9.0, 10.0, 11.0]


def test_quads_on_an_edge_see_two_cells() -> None:
    cells = shifted(0.5)
    even = np.arange(12) % 2 == 0
    assert np.asarray(cells.single.all(axis=0))[:11].tolist() == even[:11].tolist()
    assert shifted(1e-8).single[:, :11].all() and not shifted(1e-3).single[:, 1].any()
    assert shifted(0.6e-6).single[:, :11].all() and not shifted(1.6e-6).single[:, 1].any()
    # Edges between rows count as well as those between columns.
    assert np.asarray(shifted(0.0, 0.5).single.all(axis=1))[:3].tolist() == [True, False, True]
    marks = np.zeros(12, np.bool_)
    marks[1] = True
    found = shifted(0.4).spread(marks)  # quads 1 to 3 see 0.4, 1 and 0.6 of the marked cell
    assert found.dtype == np.bool_ and found[0, :5].tolist() == [False, False, True, True, False]


def test_pieces_of_cells_are_gathered_one_by_one() -> None:
    halves = ((0.0, 0.5, 1.0), (0.0, 0.25, 1.0))
    pieces = RNG.random((4, 6, 2))
    found = FILLED.gather(pieces, halves)
    assert found.shape == (4, 6, 2)
    # Two quads a cell: the left one sees both pieces across as much, the right one the second.
    left, right = pieces[:, 0::2], pieces[:, 1::2]
    np.testing.assert_allclose(found[:, 0::2], 0.5 * (left + right), rtol=1e-12)
    np.testing.assert_allclose(found[:, 1::2], right, rtol=1e-12)
    np.testing.assert_allclose(FILLED.gather(pieces[..., 1], halves), found[..., 1], rtol=1e-12)


@pytest.mark.parametrize("map_", [Map.filling((30, 20)), bent(3, (30, 20))])
@pytest.mark.parametrize("more", [(), (3,), (2, 2)])
def test_smooth_values_are_made_some_rows_at_a_time(map_: Map, more: tuple[int, ...]) -> None:
    cells = CellMap(grid=(4, 5), frame=(20, 30), map=map_)
    values = RNG.random((20, *more))
    found = cells.smooth(values)
    assert found.shape == (20, 30, *more)
    for at in np.ndindex(*more):
        rows = cells.smooth_rows(values[(slice(None), *at)])
        np.testing.assert_allclose(rows(slice(3, 9)), found[(slice(3, 9), slice(None), *at)])
        assert found[(slice(None), slice(None), *at)].flags.c_contiguous
    # No edges: what is 1 everywhere stays so, and neighbours differ little.
    np.testing.assert_allclose(cells.smooth(np.ones(20)), 1.0, rtol=1e-5)
    assert np.abs(np.diff(found, axis=1)).max() < 0.5


def test_what_has_no_map_or_no_quads_to_spare_is_not_smoothed() -> None:
    coarse = CellMap(grid=(8, 12), frame=(4, 6), map=Map.filling((6, 4)))
    one = CellMap(grid=(4, 6), frame=(4, 6), map=Map.filling((6, 4)))
    for cells in (BLOCKS, coarse, one):
        values = RNG.random(cells.grid[0] * cells.grid[1])
        np.testing.assert_allclose(cells.smooth(values), cells.spread(values), atol=1e-6)
        rows = cells.smooth_rows(values)(slice(1, 3))
        np.testing.assert_allclose(rows, cells.spread(values)[1:3], atol=1e-6)
    fine = CellMap(grid=(2, 3), frame=(4, 6), map=Map.filling((6, 4)))
    assert np.abs(fine.smooth(VALUES) - fine.spread(VALUES)).max() > 0.01
