"""What a matrix is made of, found without more work than it takes to see that there is nothing."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.recipes import factored
from pdcd.recipes.factored import factor_matrix, find_distinct_rows


@pytest.mark.parametrize("whole_cells", [0, 1024])
@pytest.mark.parametrize("rank", [1, 5, 12])
def test_a_low_rank_is_found_with_both_sides(
    whole_cells: int, rank: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(factored, "WHOLE_CELLS", whole_cells)
    rng = np.random.default_rng(3)
    matrix = rng.standard_normal((60, rank)) @ rng.standard_normal((rank, 60))
    sides = factor_matrix(matrix, 12)
    assert sides is not None
    camera, projector = sides
    assert camera.shape == projector.shape == (rank, 60)
    np.testing.assert_allclose(camera.T @ projector, matrix, atol=1e-12 * np.abs(matrix).max() * 60)
    np.testing.assert_allclose(np.sum(camera**2), np.sum(projector**2))


@pytest.mark.parametrize("whole_cells", [0, 1024])
def test_a_higher_rank_is_left_to_codes(whole_cells: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(factored, "WHOLE_CELLS", whole_cells)
    rng = np.random.default_rng(4)
    matrix = rng.standard_normal((60, 13)) @ rng.standard_normal((13, 60))
    assert factor_matrix(matrix, 12) is None
    assert factor_matrix(matrix + 1e-6 * rng.standard_normal((60, 60)), 13) is None
    assert factor_matrix(matrix, 13) is not None
    assert factor_matrix(np.eye(60), 30) is None


def test_distinct_rows_are_those_of_numpy_and_no_more_than_asked_for() -> None:
    rng = np.random.default_rng(5)
    matrix = rng.integers(0, 2, (5, 40)).astype(float)[rng.integers(0, 5, 40)]
    matrix[3] = -0.0 * matrix[3]
    rows, which = np.unique(matrix, axis=0, return_inverse=True)
    found = find_distinct_rows(matrix, len(rows))
    assert found is not None
    np.testing.assert_array_equal(found[0], rows)
    np.testing.assert_array_equal(found[1], which.ravel())
    assert find_distinct_rows(matrix, len(rows) - 1) is None
