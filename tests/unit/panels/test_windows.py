"""Windows: their strips, and whether they end where pixels end."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.panels.map import Map, PanelView
from pdcd.panels.windows import (
    ATOMS,
    MOVED,
    find_window_kind,
    is_on_whole_pixels,
    number_strips,
    split_strip_numbers,
)

GRID = (3, 4)
SIZE = (8 * GRID[1], 8 * GRID[0])
"""Eight pixels a cell: what windows of eighths of a cell need."""
EIGHTHS = "side-3/4"


def panel(**changes: Any) -> PanelView:
    """One whose pixels are spread evenly, and then changed."""
    return PanelView("mask", msgspec.structs.replace(Map.filling(SIZE), **changes))


TURNED = Map.filling(SIZE).then([[1.0, 1e-9, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("changes", [{"homography": TURNED.homography}, {"radial": (1e-9, 0.0)}])
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


SIDES = {"quarter": 1 / 2, "side-5/8": 5 / 8, "side-3/4": 3 / 4, "side-7/8": 7 / 8}
PLACES = [k / 64 for k in range(64)]
"""Of a cell, in parts that every window's edges are among; exact in floating point."""


@pytest.mark.parametrize("moved", [0, 1])
@pytest.mark.parametrize("name", SIDES)
def test_a_place_is_open_where_the_middle_of_a_cell_lies_over_it(name: str, moved: int) -> None:
    """Cells begin half a cell sooner when they are moved; an edge belongs to what begins there."""
    found, guard = find_window_kind(name), (1.0 - SIDES[name]) / 2
    for place in PLACES:
        within = (place + 0.5 * moved) % 1.0
        assert found.opens(found.strip(place), moved) == (guard <= within < 1.0 - guard), place


@pytest.mark.parametrize("name", SIDES)
def test_a_place_that_is_open_shows_the_code_cell_that_lies_over_it(name: str) -> None:
    found = find_window_kind(name)
    for place in PLACES:
        strip = found.strip(place)
        number = int(strip == MOVED and place > 0.5)  # is that of the code cell it shows
        for moved in (0, 1):
            if found.opens(strip, moved):
                shown = math.floor(place + 0.5 * moved)
                assert number + found.further(strip, moved) == shown, (place, moved)


@pytest.mark.parametrize("name", SIDES)
def test_strips_count_up_from_the_edge_of_the_field(name: str) -> None:
    """Each atom lies in the strip of its middle, and strips change nowhere but at their edges."""
    atom = np.arange(3 * ATOMS, dtype=np.int32)
    number = number_strips(name, atom)
    kind, cell = split_strip_numbers(name, number.astype(np.int64))
    assert number.dtype == np.int32 and number[0] == 0
    assert set(np.diff(number).tolist()) == {0, 1}
    for at, of_kind, of_cell in zip(atom, kind, cell, strict=True):
        place = (at + 0.5) / ATOMS
        strip = find_window_kind(name).strip(place % 1.0)
        assert of_kind == strip
        assert of_cell == math.floor(place) + (strip == MOVED and place % 1.0 > 0.5)
    assert number[ATOMS] == find_window_kind(name).kinds
