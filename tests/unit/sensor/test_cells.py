"""Cells and the quads that see them: against plain loops, by hand, and at limits."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.errors import DecodeError
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.sensor.cells import CellMap
from tests.unit.panels.test_map import bent

RNG = np.random.default_rng(5)


PLACES = [
    Placing(),
    Placing(flip="vertical", offset_px=(31.0, 8.0)),
    Placing(turn_deg=90.0),
    Placing(turn_deg=7.0, scale=1.2),
    Placing(turn_deg=-3.0, radial=(0.05, 0.0)),
]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("frame", [(23, 31), (3, 4)])
def test_shares_are_those_of_many_points(place: Placing, frame: tuple[int, int]) -> None:
    """Any frame: also one whose quads are larger than cells."""
    grid, dense = (5, 7), 40
    map_ = make_placed_map(place, (frame[1], frame[0]), (1024, 768), "camera")
    cells = CellMap(grid=grid, frame=frame, map=map_)
    values = RNG.random((35, 3))
    x, y = np.meshgrid(np.arange(frame[1] * dense) + 0.5, np.arange(frame[0] * dense) + 0.5)
    at = map_.to_field(np.stack([x, y], axis=-1) / dense) * (grid[1], grid[0])
    inside = ((at >= 0.0) & (at < (grid[1], grid[0]))).all(axis=-1)
    cell = np.where(inside, np.floor(at[..., 1]) * grid[1] + np.floor(at[..., 0]), 0).astype(int)

    def quads(points: np.ndarray) -> np.ndarray:
        blocks = points.reshape(frame[0], dense, frame[1], dense, -1)
        return np.asarray(blocks.mean(axis=(1, 3)))

    whole = quads(inside.astype(float))[..., 0] > 1.0 - 1e-9
    np.testing.assert_array_equal(cells.known, whole)
    expected = quads(values[cell])
    np.testing.assert_allclose(cells.spread(values)[whole], expected[whole], atol=0.04)

    image, sigma = RNG.random((*frame, 3)), RNG.random((*frame, 3))
    shares = np.zeros((*frame, 35))
    for n in range(35):
        shares[..., n] = quads((inside & (cell == n)).astype(float))[..., 0]
    shares[~whole] = 0.0
    seen = cells.seen()
    total = shares.sum(axis=(0, 1))[seen, None]
    mean = np.einsum("hwn,hwc->nc", shares, image)[seen] / total
    np.testing.assert_allclose(cells.mean(image)[seen], mean, atol=0.05)
    error = np.sqrt(np.einsum("hwn,hwc->nc", shares**2, sigma**2))[seen] / total
    np.testing.assert_allclose(cells.error_of_mean(sigma**2)[seen], error, atol=0.05)


@pytest.mark.parametrize("place", PLACES)
def test_smooth_is_a_plane_where_cells_are(place: Placing) -> None:
    """Bilinear between the centres of cells: no edges, and a plane stays one."""
    grid, frame = (5, 7), (40, 57)
    map_ = make_placed_map(place, (frame[1], frame[0]), (1024, 768), "camera")
    cells = CellMap(grid=grid, frame=frame, map=map_)
    row, col = np.divmod(np.arange(35), 7)
    found = cells.smooth(2.0 + 0.3 * row - 0.2 * col)
    at = cells.centres * (grid[1], grid[0]) - 0.5
    x, y = np.clip(at[..., 0], 0.0, 6.0), np.clip(at[..., 1], 0.0, 4.0)
    np.testing.assert_allclose(found, 2.0 + 0.3 * y - 0.2 * x, atol=0.02)


@pytest.mark.parametrize(
    ("grid", "frame", "map_", "sides"),
    [
        ((2, 3), (12, 18), None, [1, 2, 3, 6]),  # blocks of 6 x 6 quads
        ((2, 3), (12, 12), None, [1, 2]),  # of 6 x 4
        ((2, 3), (12, 20), None, [1, 2, 4]),  # no blocks: all of the frame
        ((2, 3), (12, 20), Placing(turn_deg=10.0), [1, 2, 4]),
        ((2, 3), (11, 20), Placing(turn_deg=10.0), [1]),
    ],
)
def test_squares_of_quads_fill_the_frame_and_blocks(
    grid: tuple[int, int], frame: tuple[int, int], map_: Placing | None, sides: list[int]
) -> None:
    place = (
        None if map_ is None else make_placed_map(map_, (frame[1], frame[0]), (64, 48), "camera")
    )
    cells = CellMap(grid=grid, frame=frame, map=place, blur_quads=0.0 if map_ is None else 0.6)
    assert [side for side in range(1, 13) if cells.can_bin(side)] == sides
    values = RNG.random(6)
    for side in sides:
        coarse = cells.binned(side)
        assert coarse.blur_quads == cells.blur_quads / side
        rows, cols = coarse.frame
        wanted = cells.spread(values).reshape(rows, side, cols, side).mean(axis=(1, 3))
        inside = cells.known.reshape(rows, side, cols, side).all(axis=(1, 3)) & coarse.known
        assert inside.any()
        np.testing.assert_allclose(coarse.spread(values)[inside], wanted[inside], atol=0.15)
        assert np.abs(coarse.spread(values) - wanted)[inside].mean() < 0.02


RANDOM = np.random.default_rng(12)
BLOCKS = CellMap.block((2, 3), (4, 6))
FILLED = CellMap(grid=(2, 3), frame=(4, 6), map=Map.filling((6, 4)))
VALUES = RANDOM.random((6, 3))
IMAGE = RANDOM.random((4, 6, 2))


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


@pytest.mark.parametrize(("right", "touched"), [(0.5, [0, 1]), (0.0, [0]), (0.005, [0])])
def test_a_quad_touches_the_cells_that_it_sees(right: float, touched: list[int]) -> None:
    quads = np.zeros((4, 12), np.bool_)
    quads[0, 1] = True
    assert np.flatnonzero(shifted(right).touched(quads)).tolist() == touched


def test_quads_on_an_edge_see_two_cells() -> None:
    cells = shifted(0.5)
    even = np.arange(12) % 2 == 0
    assert np.asarray(cells.single.all(axis=0))[:11].tolist() == even[:11].tolist()
    assert shifted(1e-8).single[:, :11].all() and not shifted(1e-3).single[:, 1].any()
    # Edges between rows count as well as those between columns.
    assert np.asarray(shifted(0.0, 0.5).single.all(axis=1))[:3].tolist() == [True, False, True]
    marks = np.zeros(12, np.bool_)
    marks[1] = True
    found = shifted(0.4).spread(marks)  # quads 1 to 3 see 0.4, 1 and 0.6 of the marked cell
    assert found.dtype == np.bool_ and found[0, :5].tolist() == [False, False, True, True, False]


def test_pieces_of_cells_are_gathered_one_by_one() -> None:
    halves = ((0.0, 0.5, 1.0), (0.0, 0.25, 1.0))
    pieces = RANDOM.random((4, 6, 2))
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
    values = RANDOM.random((20, *more))
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
        values = RANDOM.random(cells.grid[0] * cells.grid[1])
        np.testing.assert_allclose(cells.smooth(values), cells.spread(values), atol=1e-6)
        rows = cells.smooth_rows(values)(slice(1, 3))
        np.testing.assert_allclose(rows, cells.spread(values)[1:3], atol=1e-6)
    fine = CellMap(grid=(2, 3), frame=(4, 6), map=Map.filling((6, 4)))
    assert np.abs(fine.smooth(VALUES) - fine.spread(VALUES)).max() > 0.01
