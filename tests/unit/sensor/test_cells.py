"""Which pixels see which cell: spread and mean against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.panels.placing import Placing, make_placed_map
from pdcd.sensor.cells import CellMap

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
