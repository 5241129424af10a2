"""Whether windows end where pixels end: of any map, and by a count of the pixels of each strip."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.panels.map import Map, PanelView
from pdcd.panels.windows import find_window_kind, is_on_whole_pixels

GRID = (3, 4)
SIZE = (8 * GRID[1], 8 * GRID[0])
"""Eight pixels a cell: what windows of eighths of a cell need."""
EIGHTHS = "side-3/4"


def panel(**changes: Any) -> PanelView:
    """One whose pixels are spread evenly, and then changed."""
    return PanelView("mask", msgspec.structs.replace(Map.filling(SIZE), **changes))


def homography(**changes: float) -> tuple[float, ...]:
    """Of that panel, with some numbers of its three rows a to i changed."""
    names = dict(zip("abcdefghi", Map.filling(SIZE).homography, strict=True))
    return tuple({**names, **changes}.values())


@pytest.mark.parametrize(
    "changes",
    [
        # All of them leave the lines through the field's middle where they were, or about so.
        {"homography": homography(b=0.02 / SIZE[0], c=-0.01 * SIZE[1] / SIZE[0])},
        {"homography": homography(d=0.02 / SIZE[1], f=-0.01 * SIZE[0] / SIZE[1])},
        {"homography": homography(g=1e-9)},
        {"homography": homography(h=1e-9)},
        {"radial": (1e-9, 0.0)},
        {"radial": (0.0, 1e-9)},
        {"tangential": (1e-9, 0.0)},
        {"tangential": (0.0, 1e-9)},
    ],
)
def test_a_panel_that_stands_askew_or_bends_does_not_fit(changes: dict[str, Any]) -> None:
    """Half windows and whole cells take any panel: each pixel is in one of theirs."""
    assert not is_on_whole_pixels(EIGHTHS, panel(**changes), GRID)
    for name in ("whole", "quarter"):
        assert is_on_whole_pixels(name, panel(**changes), GRID)


@pytest.mark.parametrize("name", ["side-5/8", "side-3/4", "side-7/8"])
@pytest.mark.parametrize("axis", [0, 1])
def test_cells_of_so_many_pixels_fit(name: str, axis: int) -> None:
    """Where each window, in place and moved by half, opens and ends at a whole pixel."""
    half = 0.5 * find_window_kind(name).side
    ends = np.array([0.5 - half, 0.5 + half, half, 1.0 - half])
    for pixels in range(1, 33):
        per_cell = [32, 32]
        per_cell[axis] = pixels
        size_px = (per_cell[0] * GRID[1], per_cell[1] * GRID[0])
        view = PanelView("mask", Map.filling(size_px))
        fits = bool((pixels * ends == np.rint(pixels * ends)).all())
        assert is_on_whole_pixels(name, view, GRID) == fits, pixels
