"""The pixels of a panel: exact fractions, and the cells of the lattice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.frames.bitplanes import pack_planes
from pdcd.frames.draw import draw, draw_planes
from pdcd.frames.frames import BLACK
from pdcd.frames.lattice import Lattice
from pdcd.frames.patterns import levels_of
from tests.panel_pixels import planned, random_frames

SIZE = (90, 70)


@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize("grid", [(10, 15), (7, 11), (23, 29), (1, 1), (70, 90)])
def test_every_pixel_by_exact_fractions(
    grid: tuple[int, int], window: str, grey: bool, mask: bool
) -> None:
    frames = random_frames(grid, window, 8, grey=grey)
    for row in range(len(frames)):
        found = draw(frames, SIZE, row, mask=mask)
        assert found.dtype == np.uint8
        np.testing.assert_array_equal(found, planned(frames, row, SIZE, mask=mask))


@pytest.mark.parametrize("mask", [False, True])
def test_a_row_for_none_is_black(mask: bool) -> None:
    assert not draw(random_frames((6, 8), "whole", 4), SIZE, BLACK, mask=mask).any()


@pytest.mark.parametrize("mask", [False, True])
def test_planes_are_rows(mask: bool) -> None:
    frames = random_frames((6, 8), "quarter", 20)
    rows = [*range(20), BLACK, 3]
    found = draw_planes(frames, SIZE, rows, mask=mask, order="RBG")
    planes = [draw(frames, SIZE, row, mask=mask) == 255 for row in rows]
    np.testing.assert_array_equal(found, pack_planes(np.stack(planes), "RBG"))
    assert found.shape == (70, 90, 3)
    assert not draw_planes(frames, SIZE, [], mask=mask).any()


def test_what_cannot_be_drawn_is_refused() -> None:
    frames = random_frames((6, 8), "whole", 4)
    for row in (4, -2):
        with pytest.raises(ConfigError, match=f"no row {row}"):
            draw(frames, SIZE, row, mask=True)
    with pytest.raises(ConfigError, match="6 x 8 cells do not fit 5 x 9 px") as caught:
        draw(frames, (9, 5), 0, mask=True)
    assert caught.value.device == "mask"
    with pytest.raises(ConfigError, match="grey levels"):
        draw_planes(random_frames((6, 8), "whole", 4, grey=True), SIZE, [0], mask=True)


@pytest.mark.parametrize(
    ("window", "shift"), [("whole", 0), *(("quarter", shift) for shift in range(4))]
)
def test_pixels_are_what_the_lattice_says(window: str, shift: int) -> None:
    """Cell means of both panels, and of their product, where quarters of cells divide the panel."""
    grid, size = (6, 5), (40, 24)
    frames, lattice = random_frames(grid, window, 8), Lattice(grid, window)
    row = shift if window == "quarter" else 0
    light = draw(frames, size, row, mask=False) / 255
    opening = draw(frames, size, row, mask=True) / 255
    primal = levels_of(frames.primal_patterns, frames.primal_index[row], lattice.lattice_cells)
    dual = levels_of(frames.dual_patterns, frames.dual_index[row], lattice.lattice_cells)
    fields = lattice.primal_field_values(primal, shift)
    windows = lattice.dual_field_values(dual, shift)
    np.testing.assert_allclose(cell_means(light, grid), fields.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(
        cell_means(opening, grid), windows.ravel() @ lattice.spread, atol=1e-12
    )
    coaxial = sum(
        o.area * lattice.seen(windows[o.dual_field][None], o)[0].ravel() * fields[o.primal_field]
        for o in lattice.overlaps
    )
    np.testing.assert_allclose(cell_means(light * opening, grid), coaxial, atol=1e-12)


def cell_means(image: np.ndarray[Any, Any], grid: tuple[int, int]) -> np.ndarray[Any, Any]:
    rows, cols = grid
    height, width = image.shape
    blocks = image.reshape(rows, height // rows, cols, width // cols)
    return np.asarray(blocks.mean(axis=(1, 3))).ravel()
