"""Which pixels see which cell: spread and mean against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.errors import DecodeError
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.sensor.cells import CellMap

RNG = np.random.default_rng(5)


@pytest.mark.parametrize(("grid", "block"), [((2, 3), (4, 2)), ((1, 5), (1, 1)), ((4, 1), (3, 3))])
@pytest.mark.parametrize("more", [(), (3,)])
def test_spread_gives_each_pixel_the_value_of_its_cell(
    grid: tuple[int, int], block: tuple[int, int], more: tuple[int, ...]
) -> None:
    frame = (grid[0] * block[0], grid[1] * block[1])
    values = RNG.random((grid[0] * grid[1], *more))
    image = CellMap.block(grid, frame).spread(values)
    assert image.shape == (*frame, *more)
    for y in range(frame[0]):
        for x in range(frame[1]):
            cell = (y // block[0]) * grid[1] + x // block[1]
            np.testing.assert_array_equal(image[y, x], values[cell])


def test_the_mean_of_a_cell_is_that_of_its_pixels() -> None:
    cells = CellMap.block((2, 3), (4, 9))
    image = RNG.random((4, 9, 3))
    means = cells.mean(image)
    assert means.shape == (6, 3)
    np.testing.assert_allclose(means[4], image[2:4, 3:6].reshape(6, 3).mean(axis=0), rtol=1e-15)
    values = RNG.random((6, 3))
    np.testing.assert_allclose(cells.mean(cells.spread(values)), values, rtol=1e-15)


@pytest.mark.parametrize("frame", [(48, 65), (47, 64), (0, 64), (24, 32)])
def test_a_frame_that_the_grid_does_not_divide_is_refused(frame: tuple[int, int]) -> None:
    with pytest.raises(DecodeError, match=f"{frame[0]} x {frame[1]} pixels.*48 x 64 cells"):
        CellMap.block((48, 64), frame)


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
