"""Which pixels see which cell: spread and mean against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.errors import DecodeError
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
