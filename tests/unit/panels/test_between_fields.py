"""Homographies between fields: points by hand, and at which matrix and which depth they end."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.panels.placing import project_points

SWAP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
"""(x, y) becomes (x / y, 1 / y): a point's depth is its y."""


def of(matrix: np.ndarray, *points: tuple[float, float]) -> list[list[float]]:
    return project_points(tuple(matrix.ravel().tolist()), np.array(points)).tolist()  # type: ignore[no-any-return]


@pytest.mark.parametrize("size", [1.0, 1000.0, 0.001, -2.0])
def test_points_go_through_whatever_the_size_of_the_numbers(size: float) -> None:
    matrix = np.array([[2.0, 1.0, 3.0], [0.0, 4.0, 5.0], [1.0, 0.0, 2.0]])
    found = of(size * matrix, (0.0, 0.0), (1.0, 0.0), (2.0, 1.0))
    np.testing.assert_allclose(found, [[1.5, 2.5], [5 / 3, 5 / 3], [2.0, 2.25]], rtol=1e-14)


@pytest.mark.parametrize("size", [1.0, 1000.0, 0.001])
def test_a_matrix_is_singular_below_a_share_of_its_largest_entry(size: float) -> None:
    (found,) = of(size * np.diag([1.0, 1.5e-9, 1.0]), (0.5, 0.5))
    assert found == pytest.approx([0.5, 0.75e-9])
    with pytest.raises(ValueError, match="has no inverse"):
        of(size * np.diag([1.0, 0.7e-9, 1.0]), (0.5, 0.5))


@pytest.mark.parametrize("size", [1.0, 1000.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_all_points_lie_on_one_side_of_the_horizon(size: float, side: float) -> None:
    near = side * 1.5e-6
    np.testing.assert_allclose(
        of(size * SWAP, (0.0, near), (1.0, side)), [[0.0, 1.0 / near], [side, side]]
    )
    for depths in ((0.7e-6 * side, side), (side, 1e-6 * side), (side, -side), (-0.5, 0.5), (0.0,)):
        with pytest.raises(ValueError, match="a part of the field to infinity"):
            of(size * SWAP, *((0.0, depth) for depth in depths))
