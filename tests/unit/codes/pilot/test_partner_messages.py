"""What neighbours say of partners, and where light comes from, by trying all of them."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.codes.pilot import matching
from pdcd.codes.pilot.matching import BREAK_COST, FAR_COST


@pytest.mark.parametrize("grid", [(6, 7), (1, 9), (5, 1)])
def test_a_message_is_the_best_partner_less_what_its_distance_costs(grid: tuple[int, int]) -> None:
    """Relative to the best of all: one cell apart for nothing, two for a little, and anywhere."""
    rng = np.random.default_rng(1)
    belief = rng.normal(0.0, 6.0, (2, *grid)).astype(np.float32)
    row, col = np.divmod(np.arange(belief[0].size), grid[1])
    apart = np.maximum(np.abs(row[:, None] - row), np.abs(col[:, None] - col))
    cost = np.select([apart <= 1, apart <= 2], [0.0, FAR_COST], BREAK_COST)
    wanted = (belief.reshape(2, 1, -1) - cost).max(axis=2) - belief.reshape(2, -1).max(axis=1)[
        :, None
    ]
    found = matching._told(belief)
    np.testing.assert_allclose(found.reshape(2, -1), wanted, atol=1e-5)
    assert found.min() >= -BREAK_COST and found.max() == 0.0


def test_neighbours_of_a_cell_share_its_highest_belief() -> None:
    belief = np.zeros((5, 6), dtype=np.float32)
    belief[0, 5], belief[3, 2] = 2.0, 5.0
    wanted = np.zeros((5, 6))
    wanted[:2, 4:], wanted[2:5, 1:4] = 2.0, 5.0
    np.testing.assert_array_equal(matching._spread(belief), wanted)
    assert belief.sum() == 7.0  # what was given stays


def test_means_and_spreads_around_cells_are_those_of_a_bell() -> None:
    """Even values have the least variance; a step has its mean on either side, far from it."""
    grid, least = (3, 40), np.full(120, 1e-4)
    middle, variance = matching._local(np.full(120, 0.7), 2.0, grid, least)
    np.testing.assert_allclose(middle, 0.7)
    np.testing.assert_array_equal(variance, least)
    step = np.tile(np.where(np.arange(40) < 20, 0.0, 1.0), 3)
    middle, variance = matching._local(step, 1.2, grid, least)
    line, spread = middle.reshape(grid)[1], variance.reshape(grid)[1]
    assert line[:10] == pytest.approx(0.0, abs=1e-6) and line[-10:] == pytest.approx(1.0, abs=1e-6)
    assert line[19] + line[20] == pytest.approx(1.0)
    # Half a cell beside the step: a normal distribution of 1.2 cells has 0.338 beyond it.
    assert line[19] == pytest.approx(0.338, abs=0.01)
    assert spread.argmax() in (19, 20) and spread[:8] == pytest.approx(1e-4)


def test_operators_take_what_lies_beyond_the_border_at_it() -> None:
    found = matching._operator({(0, 0): 0.5, (1, -1): 0.25, (0, 2): 0.0}, (2, 3)).toarray()
    wanted = np.zeros((6, 6))
    for cell, there in enumerate((3, 3, 4, 3, 3, 4)):
        wanted[cell, cell] += 0.5
        wanted[cell, there] += 0.25
    np.testing.assert_allclose(found, wanted)
