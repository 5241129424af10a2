"""Cells of codes on both panels, by looking at single places of the field."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pdcd.panels.lattice import Lattice, Piece
from pdcd.panels.windows import LOWER, MOVED, PLACED, UPPER

GRID = (2, 3)
CENTRE = {PLACED: 0.5, MOVED: 0.0, LOWER: 0.25, UPPER: 0.75}
"""Of a strip, from the edge of the cell that it is numbered by."""


def pattern(lattice: Lattice) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.random.default_rng(2).random(lattice.lattice_cells)


def test_the_grid_goes_on_over_its_far_edges() -> None:
    nearest, down, right = Lattice(GRID, "quarter").continued
    assert nearest.tolist() == [0, 1, 2, 2, 3, 4, 5, 5, 3, 4, 5, 5]
    assert down.tolist() == [0] * 8 + [1] * 4
    assert right.tolist() == [0, 0, 0, 1] * 3
    nearest, down, right = Lattice(GRID).continued
    assert nearest.tolist() == list(range(6)) and not down.any() and not right.any()


@pytest.mark.parametrize("shift", range(4))
def test_halves_of_cells_see_the_code_cell_over_them(shift: int) -> None:
    """Bit 0 of a sub-shift moves codes by half a cell to the left, bit 1 upwards."""
    lattice = Lattice(GRID, "quarter")
    full = pattern(lattice).reshape(lattice.shape)
    values = lattice.primal_field_values(full.ravel(), shift).reshape(4, *GRID)
    for field, row, col in np.ndindex(4, *GRID):
        y = row + 0.25 + 0.5 * (field >> 1) + 0.5 * (shift >> 1)
        x = col + 0.25 + 0.5 * (field & 1) + 0.5 * (shift & 1)
        assert values[field, row, col] == full[math.floor(y), math.floor(x)]


@pytest.mark.parametrize("shift", range(4))
@pytest.mark.parametrize("window", ["quarter", "side-5/8", "side-7/8"])
def test_strips_of_the_mask_show_the_code_cell_over_them_or_nothing(
    window: str, shift: int
) -> None:
    lattice = Lattice(GRID, window)
    full = pattern(lattice).reshape(lattice.shape)
    values = lattice.dual_field_values(full.ravel(), shift)
    assert values.shape == (lattice.dual_fields, lattice.lattice_cells + 1)
    assert not values[:, -1].any()  # the rest of the panel
    guard, moved = lattice.opening.guard, (shift >> 1, shift & 1)
    for field, row, col in np.ndindex(lattice.dual_fields, *lattice.shape):
        places = [
            at + CENTRE[strip] + 0.5 * by
            for at, strip, by in zip((row, col), lattice.strips(field), moved, strict=True)
        ]
        wanted = 0.0
        if all(guard <= place % 1.0 < 1.0 - guard for place in places):
            y, x = (math.floor(place) for place in places)
            wanted = full[y, x] if y < full.shape[0] and x < full.shape[1] else 0.0
        assert values[field, row * full.shape[1] + col] == wanted


@pytest.mark.parametrize(
    ("window", "offset", "wanted"),
    [
        ("quarter", 0.0, [(0, 4, MOVED, 0), (4, 12, PLACED, 0), (12, 16, MOVED, 1)]),
        ("quarter", 0.125, [(0, 2, MOVED, 0), (2, 10, PLACED, 0), (10, 16, MOVED, 1)]),
        ("quarter", -0.5, [(0, 4, PLACED, -1), (4, 12, MOVED, 0), (12, 16, PLACED, 0)]),
        (
            "side-5/8",
            0.0,
            [(0, 3, MOVED, 0), (3, 5, LOWER, 0), (5, 11, PLACED, 0), (11, 13, UPPER, 0),
             (13, 16, MOVED, 1)],
        ),
        (
            "side-7/8",
            1.0,
            [(0, 1, MOVED, 1), (1, 7, LOWER, 1), (7, 9, PLACED, 1), (9, 15, UPPER, 1),
             (15, 16, MOVED, 2)],
        ),
    ],
)  # fmt: skip
def test_cells_are_cut_where_windows_end(
    window: str, offset: float, wanted: list[tuple[int, int, int, int]]
) -> None:
    """In sixteenths of a cell; MOVED strips are numbered by the code cell that they show."""
    down, right = Lattice(GRID, window, (0.0, offset)).pieces
    assert right == tuple(Piece(low / 16, high / 16, *rest) for low, high, *rest in wanted)
    assert down == Lattice(GRID, window).pieces[0]


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.125, -0.3), (-0.75, 0.25), (1e-17, 0.5 + 1e-16)])
@pytest.mark.parametrize("window", ["whole", "quarter", "side-5/8", "side-7/8"])
def test_parts_of_cells_are_where_their_places_are(
    window: str, offset: tuple[float, float]
) -> None:
    """By 80 x 80 places of a cell, between all edges: the share in which two fields meet."""
    lattice, count = Lattice(GRID, window, offset), 80
    found: dict[tuple[int, int, int, int], int] = {}
    for i, j in np.ndindex(count, count):
        key = [0, 0, 0, 0]
        for axis, at in enumerate((i, j)):
            place = (at + 0.5) / count
            there = place + offset[axis]
            strip = lattice.opening.strip(there % 1.0)
            step = math.floor(there)
            if strip == MOVED and lattice.opening.shifted:
                step = math.floor(there + 0.5)
            weight = (lattice.opening.kinds, 1)[axis]
            key[0] += weight * strip
            key[1] += (2, 1)[axis] * int(place >= 0.5) * lattice.opening.shifted
            key[2 + axis] = step
        entry = (key[0], key[1], key[2], key[3])
        found[entry] = found.get(entry, 0) + 1
    parts = {(o.dual_field, o.primal_field, *o.step): o.area for o in lattice.overlaps}
    assert parts.keys() == found.keys()
    for part, area in parts.items():
        assert area == pytest.approx(found[part] / count**2, abs=1e-12)
    of_windows: dict[tuple[int, int, int], float] = {}
    for o in lattice.windows:
        assert o.primal_field == 0
        of_windows[(o.dual_field, *o.step)] = o.area
    summed: dict[tuple[int, int, int], float] = {}
    for (dual, _, *step), area in parts.items():
        summed[(dual, step[0], step[1])] = summed.get((dual, step[0], step[1]), 0.0) + area
    assert of_windows == pytest.approx(summed)
