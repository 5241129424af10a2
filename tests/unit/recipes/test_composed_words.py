"""How a plain matrix is taken apart, in words, and the sum of photos that it is then."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.probing.wanted import NearPart
from pdcd.recipes.structure import find_structure

GRID = (9, 12)
N = 108
Floats = NDArray[np.float64]
RNG = np.random.default_rng(21)
WARP = RNG.permutation(N)


def by_warp(partner: NDArray[np.int64]) -> Floats:
    out = np.zeros((N, N))
    there = np.flatnonzero(partner >= 0)
    out[there, partner[there]] = 1.0
    return out


@pytest.mark.parametrize(("cells", "found"), [(7, True), (6, False)])
def test_matched_cells_of_one_weight_are_a_sixteenth_of_all(cells: int, found: bool) -> None:
    """108 cells: 6.75 of them."""
    partner = np.full(N, -1)
    partner[RNG.permutation(N)[:cells]] = RNG.permutation(N)[:cells]
    made = find_structure(1.0 - 0.4 * by_warp(partner), GRID)
    assert made.level == 1.0 and len(made.matches) == found
    assert (made.rest is None) == found
    if found:
        assert made.matches[0][0] == -0.4
        np.testing.assert_array_equal(made.matches[0][1], partner)


@pytest.mark.parametrize(("cells", "found"), [(4, True), (3, False)])
def test_of_few_cells_four_must_be_matched(cells: int, found: bool) -> None:
    matrix = np.ones((40, 40))
    matrix[[1, 11, 22, 33][:cells], [30, 7, 5, 18][:cells]] = 0.25
    made = find_structure(matrix, (5, 8))
    assert len(made.matches) == found and (made.rest is None) == found


@pytest.mark.parametrize(
    ("weights", "near"),
    [
        ([1.0], ((1.0, 1),)), ([1.0, 0.5], ((0.5, 1), (0.5, 2))),
        ([0.5, 0.5], ((0.5, 2),)), ([1.0, 0.75, 0.5], ()),
    ],
)  # fmt: skip
def test_bands_have_two_weights_at_most(
    weights: list[float], near: tuple[tuple[float, int], ...]
) -> None:
    grid = (14, 16)
    cells = np.arange(224)
    far = np.maximum(
        np.abs(cells[:, None] // 16 - cells // 16), np.abs(cells[:, None] % 16 - cells % 16)
    )
    matrix = 3.0 + np.r_[weights[0], weights, np.zeros(16)][far]
    made = find_structure(matrix, grid)
    assert made.near == near and made.level == 3.0
    np.testing.assert_allclose(made.rows(0, 224), matrix, atol=1e-9)


@pytest.mark.parametrize(("damaged", "found"), [(9, True), (10, False)])
def test_nine_tenths_of_a_ring_have_its_weight(damaged: int, found: bool) -> None:
    """99 cells have a neighbour to their right."""
    matrix = 2.0 - NearPart(GRID, 1).rows(0, N)
    cells = [row * 12 + col for col in range(11) for row in range(9)]
    for cell in cells[:damaged]:
        matrix[cell, cell + 1] = 2.0 + 0.1 * cell
    made = find_structure(matrix, GRID)
    assert made.near == (((-1.0, 1),) if found else ())


def test_rows_of_a_structure_are_those_of_its_sum() -> None:
    seen, lit = RNG.random((2, N)), RNG.random((2, N))
    matrix = seen.T @ lit + by_warp(WARP) - 0.5 * NearPart(GRID, 1).rows(0, N)
    made = find_structure(matrix, GRID)
    assert made.found and len(made.camera) == 2
    for start, stop in ((0, N), (3, 8), (100, N), (5, 5)):
        np.testing.assert_allclose(made.rows(start, stop), matrix[start:stop], atol=1e-6)
