"""How large the numbers of a goal may be: what makes sense on a grid, and what arithmetic allows.

Checked before any work is done and anything is allocated. Other conditions on a number (odd,
positive, a multiple of 4) are in `pdcd.recipes.goals`; what makes sense on no grid is refused by
the type of the request.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import RequestError
from pdcd.protocol.plan_summary import Goal

_LEAST_P = 1.0 / 65536
"""Least share of codes in which a cell is lit: once in the largest number of codes there is."""
WEIGHTS = 1e-6, 1e6
"""Bounds of the largest weight of a mix, a kernel or a matrix. Only ratios of weights matter, and
these bounds leave room for sums and squares of them."""


def check_bounds(
    goal: Goal, grid: tuple[int, int], matrices: Mapping[str, NDArray[np.float64]]
) -> None:
    """Refuse numbers that make no sense on a grid of (rows, columns). Raises RequestError, which
    names the limit.

    `matrices` are the goal's kernel and matrix, by name; of any shape.
    """
    where = f"on a grid of {grid[0]} x {grid[1]} cells"
    if goal.p is not None and not _LEAST_P <= goal.p <= 1.0 - _LEAST_P:
        raise RequestError(
            f"p = {goal.p:g} lights cells never, or always",
            hint=f"take p from {_LEAST_P:.2g} to 1 - {_LEAST_P:.2g}",
        )
    if goal.radius is not None and goal.radius > max(grid):
        raise RequestError(
            f"a radius of {_short(goal.radius)} cells is larger than anything {where}",
            hint=f"take a radius of at most {max(grid)}",
        )
    if goal.shift is not None and any(
        abs(step) >= side for step, side in zip(goal.shift, grid, strict=True)
    ):
        raise RequestError(
            f"a shift of {' '.join(map(_short, goal.shift))} leaves the grid: no cell is that far "
            f"off {where}",
            hint=f"take at most {grid[0] - 1} cells down and {grid[1] - 1} cells right",
        )
    if goal.period is not None and goal.period > grid[1]:
        raise RequestError(
            f"a period of {_short(goal.period)} cells is longer than a row {where}",
            hint=f"take a multiple of 4 up to {grid[1] // 4 * 4}",
        )
    if goal.mix is not None:
        _check_strength("mix", np.array(goal.mix))
    for name, matrix in matrices.items():
        _check_matrix(name, matrix, grid, where)


def _check_matrix(
    name: str, matrix: NDArray[np.float64], grid: tuple[int, int], where: str
) -> None:
    sides = 2 * grid[0] - 1, 2 * grid[1] - 1
    if name == "kernel" and matrix.ndim == 2 and any(np.greater(matrix.shape, sides)):
        raise RequestError(
            f"a kernel of {matrix.shape[0]} x {matrix.shape[1]} reaches further than any path "
            f"{where}",
            hint=f"take at most {sides[0]} x {sides[1]} weights",
        )
    _check_strength(name, matrix)


def _check_strength(name: str, weights: NDArray[np.float64]) -> None:
    largest = max(abs(float(weights.max())), abs(float(weights.min()))) if weights.size else 0.0
    if largest and not WEIGHTS[0] <= largest <= WEIGHTS[1]:  # nan is refused here, too
        raise RequestError(
            f"the largest weight of {name} is {largest:.3g}",
            hint=f"scale it to between {WEIGHTS[0]:g} and {WEIGHTS[1]:g}: only ratios matter",
        )


def _short(number: int) -> str:
    """The number in digits, or its size where those would fill a page."""
    return str(number) if abs(number) < 10**12 else f"{'-' if number < 0 else ''}10^12 or more"
