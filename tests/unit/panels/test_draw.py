"""The pixels of a panel: exact fractions, maps, and the cells of the lattice."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.draw import draw, draw_planes
from pdcd.panels.frames import BLACK
from pdcd.panels.lattice import Lattice
from pdcd.panels.map import PanelView
from pdcd.panels.patterns import pack_planes, read_pattern_levels
from pdcd.panels.placing import Placing, make_placed_map
from tests.panel_pixels import planned, random_frames, upright

SIZE = (90, 70)
MASK = upright(SIZE, mask=True)
BENT = Placing(
    flip="horizontal", turn_deg=11.0, scale=1.3, offset_px=(1.5, -2.5), radial=(0.04, -0.02)
)


@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize(
    ("window", "grid"),
    [*product(["whole", "quarter"], [(10, 15), (7, 11), (23, 29), (1, 1), (70, 90)]),
     ("side-5/8", (7, 11)), ("side-3/4", (7, 11)), ("side-7/8", (3, 5)), ("side-7/8", (7, 11))],
)  # fmt: skip
def test_every_pixel_by_exact_fractions(
    grid: tuple[int, int], window: str, grey: bool, mask: bool
) -> None:
    panel = upright(SIZE, mask=mask)
    frames = random_frames(grid, window, 8, grey=grey)
    for row in range(len(frames)):
        found = draw(frames, panel, row)
        assert found.dtype == np.uint8
        np.testing.assert_array_equal(found, planned(frames, row, panel))


@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("window", ["whole", "quarter", "side-5/8"])
def test_every_pixel_under_a_map_that_bends(window: str, grey: bool, mask: bool) -> None:
    """Mirrored, turned, distorted, larger than the field; beside it even white is dark."""
    panel = PanelView("mask" if mask else "projector", make_placed_map(BENT, SIZE, SIZE, "panel"))
    frames = random_frames((7, 11), window, 8, grey=grey)
    for row in range(len(frames)):
        np.testing.assert_array_equal(draw(frames, panel, row), planned(frames, row, panel))
    white = draw(frames, panel, 4 if mask else 7)
    assert 0.2 < (white == 0).mean() < 0.5 and set(np.unique(white)) == {0, 255}


@pytest.mark.parametrize("mask", [False, True])
def test_a_row_for_none_is_black(mask: bool) -> None:
    assert not draw(random_frames((6, 8), "whole", 4), upright(SIZE, mask=mask), BLACK).any()


@pytest.mark.parametrize("mask", [False, True])
def test_planes_are_rows(mask: bool) -> None:
    frames = random_frames((6, 8), "quarter", 20)
    rows = [*range(20), BLACK, 3]
    panel = upright(SIZE, mask=mask)
    found = draw_planes(frames, panel, rows, order="RBG")
    planes = [draw(frames, panel, row) == 255 for row in rows]
    np.testing.assert_array_equal(found, pack_planes(np.stack(planes), "RBG"))
    assert found.shape == (70, 90, 3)
    assert not draw_planes(frames, panel, []).any()


def test_what_cannot_be_drawn_is_refused() -> None:
    frames = random_frames((6, 8), "whole", 4)
    for row in (4, -2):
        with pytest.raises(ConfigError, match=f"no row {row}"):
            draw(frames, MASK, row)
    with pytest.raises(ConfigError, match=r"8 of 6 x 8 cells have no pixel .* 5 x 9 px") as caught:
        draw(frames, upright((9, 5), mask=True), 0)
    assert caught.value.device == "mask"
    with pytest.raises(ConfigError, match="grey levels"):
        draw_planes(random_frames((6, 8), "whole", 4, grey=True), MASK, [0])


@pytest.mark.parametrize(
    ("window", "shift"), [("whole", 0), *(("quarter", shift) for shift in range(4))]
)
def test_pixels_are_what_the_lattice_says(window: str, shift: int) -> None:
    """Cell means of both panels, and of their product, where quarters of cells divide the panel."""
    grid, size = (6, 5), (40, 24)
    frames, lattice = random_frames(grid, window, 8), Lattice(grid, window)
    row = shift if window == "quarter" else 0
    light = draw(frames, upright(size, mask=False), row) / 255
    opening = draw(frames, upright(size, mask=True), row) / 255
    primal = read_pattern_levels(
        frames.primal_patterns, frames.primal_index[row], lattice.lattice_cells
    )
    dual = read_pattern_levels(frames.dual_patterns, frames.dual_index[row], lattice.lattice_cells)
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
