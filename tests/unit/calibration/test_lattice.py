"""Dots are counted along their lattice, and told by the code in the cells amid them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.geometry.lattice import SYMMETRIES, find_lattice_place, index_dots

Floats = NDArray[np.float64]
CODE = np.random.default_rng(8).random((14, 19)) < 0.5
"""Holes of the whole panel."""


def lattice(
    rows: int, cols: int, right: complex, down: complex
) -> tuple[Floats, NDArray[np.int64]]:
    """Points of a lattice in any order, and their (column, row)."""
    index = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1).reshape(-1, 2)
    z = index[:, 0] * right + index[:, 1] * down + (300.0 + 200.0j)
    order = np.random.default_rng(3).permutation(len(index))
    return np.stack([z.real, z.imag], axis=-1)[order], index[order]


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 44.0, 90.0, 200.0])
@pytest.mark.parametrize("shear", [0.0, 0.25])
def test_all_dots_are_counted_from_some_dot_on(turn_deg: float, shear: float) -> None:
    turn = np.exp(1j * np.radians(turn_deg))
    points, index = lattice(6, 8, 10.0 * turn, (10.0j + 10.0 * shear) * turn)
    counts, which = index_dots(points)
    assert sorted(which.tolist()) == list(range(48))
    # Counts are the grid's own but for a start and quarter turns: steps stay steps.
    columns = np.concatenate([index[which], np.ones((48, 1), np.int64)], axis=1)
    steps, *_ = np.linalg.lstsq(columns, counts.astype(float), rcond=None)
    whole = np.rint(steps[:2])
    np.testing.assert_allclose(columns @ steps, counts, atol=1e-9)
    assert np.linalg.det(whole) == pytest.approx(1.0)  # right-handed, as it is in the photo


def test_dots_off_the_lattice_are_no_steps_of_it() -> None:
    """By a fifth of a step a dot is still counted, by 0.4 it is not; nor what lies far off."""
    points, index = lattice(5, 7, 10.0, 10.0j)
    for off, kept in ((2.0, 35), (4.0, 34)):
        moved = points.copy()
        corner = int(np.flatnonzero((index == (0, 0)).all(axis=1))[0])
        moved[corner] -= (off, 0.0)
        assert len(index_dots(moved)[1]) == kept
    stray = np.concatenate([points, [[500.0, 500.0], [560.0, 507.0]]])
    assert sorted(index_dots(stray)[1].tolist()) == list(range(35))


def test_dots_in_a_line_have_no_second_direction() -> None:
    line = np.stack([np.arange(9.0) * 10.0, np.zeros(9)], axis=-1)
    assert len(index_dots(line)[1]) == 0


def cells_of(symmetry: int, shift: tuple[int, int], rows: int, cols: int) -> Floats:
    """What a part of the code looks like in counts whose `index` is that symmetry and shift."""
    turn = np.array(SYMMETRIES[symmetry])
    low = np.zeros((rows, cols))
    for row in range(rows):
        for col in range(cols):
            # A cell lies amid the dots of (col, row) and (col + 1, row + 1).
            middle = turn @ np.array([col + 0.5, row + 0.5]) + shift
            at = np.floor(middle).astype(int)
            low[row, col] = -1.0 if CODE[at[1], at[0]] else 1.0
    return low


@pytest.mark.parametrize(
    ("symmetry", "shift"),
    [
        (0, (3, 2)), (1, (12, 2)), (2, (12, 10)), (3, (3, 10)),
        (4, (12, 2)), (5, (3, 2)), (6, (3, 10)), (7, (12, 10)),
    ],
)  # fmt: skip
def test_a_part_of_the_code_is_found_whichever_way_it_is_seen(
    symmetry: int, shift: tuple[int, int]
) -> None:
    cells = cells_of(symmetry, shift, 6, 8)
    cells[1, 2] = np.nan
    found = find_lattice_place(cells, CODE)
    assert found.symmetry.tolist() == [list(row) for row in SYMMETRIES[symmetry]]
    assert found.shift.tolist() == list(shift)
    assert found.sure and found.score > 0.9
    dots = np.array([[0, 0], [2, 1], [5, 4]])
    wanted = [np.array(SYMMETRIES[symmetry]) @ dot + shift for dot in dots]
    assert found.index(dots).tolist() == [w.tolist() for w in wanted]


def test_chance_is_not_sure() -> None:
    noise = np.where(np.random.default_rng(1).random((6, 8)) < 0.5, -1.0, 1.0)
    assert not find_lattice_place(noise, CODE).sure
    assert not find_lattice_place(np.zeros((3, 3)), CODE).sure


def test_more_cells_than_the_panel_has_have_no_place() -> None:
    """15 x 15 cells fit in no way into 14 x 19; 14 x 15 do lying, but not standing."""
    found = find_lattice_place(np.ones((15, 15)), CODE)
    assert (found.score, found.lead) == (0.0, 0.0)
    upright = cells_of(0, (2, 0), 14, 15)
    assert find_lattice_place(upright, CODE).shift.tolist() == [2, 0]


def test_steps_may_change_slowly() -> None:
    """Each step is 4 % longer than that before."""
    across = np.concatenate([[0.0], np.cumsum(10.0 * 1.04 ** np.arange(14))])
    x, y = np.meshgrid(across, across[:8])
    counts, which = index_dots(np.stack([x.ravel(), y.ravel()], axis=-1))
    assert len(which) == 15 * 8 == len({tuple(c) for c in counts.tolist()})
