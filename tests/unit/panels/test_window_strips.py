"""Strips of windows: when each place of a cell opens, and for which code cell."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pdcd.panels.windows import ATOMS, MOVED, find_window_kind, number_strips, split_strip_numbers

SIDES = {"quarter": 1 / 2, "side-5/8": 5 / 8, "side-3/4": 3 / 4, "side-7/8": 7 / 8}
PLACES = [k / 64 for k in range(64)]
"""Of a cell, in parts that every window's edges are among; exact in floating point."""


@pytest.mark.parametrize("name", SIDES)
def test_a_window_has_the_side_of_its_name(name: str) -> None:
    found = find_window_kind(name)
    assert found.shifted and found.name == name
    assert found.side == SIDES[name] and found.area == SIDES[name] ** 2
    assert found.guard == (1.0 - SIDES[name]) / 2
    assert found.kinds == (2 if name == "quarter" else 4)


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
