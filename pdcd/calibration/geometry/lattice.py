"""Which dot is which: dots in a photo are counted along their lattice, then identified by the
code."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate
from scipy.spatial import cKDTree

from pdcd.arrays import Floats, Indices

_NEAR = 0.3
"""Largest distance of a dot from its predicted place, in lattice steps."""
_SEEDS = 9
"""Dots from which counting starts, one after the other, until enough dots are counted."""
_ENOUGH = 0.6
"""Share of the dots that must be counted for no other start to be tried."""
_LEAST_SCORE, _LEAST_LEAD = 0.6, 0.25
"""Least agreement with the code, and its least lead over the second best place. Chance alone
reaches 4.5 / sqrt(places) of all places, turns and mirrors."""

SYMMETRIES: tuple[tuple[tuple[int, int], tuple[int, int]], ...] = (
    ((1, 0), (0, 1)),
    ((0, -1), (1, 0)),
    ((-1, 0), (0, -1)),
    ((0, 1), (-1, 0)),
    ((-1, 0), (0, 1)),
    ((0, 1), (1, 0)),
    ((1, 0), (0, -1)),
    ((0, -1), (-1, 0)),
)
"""Turns, then mirrored turns, of (column, row)."""


@dataclass(frozen=True)
class LatticePlace:
    """Where counted dots lie in their grid: `index = symmetry @ counted + shift`.

    score : agreement with the code, 1 at best. lead : of the score over the second best.
    """

    symmetry: Indices
    shift: Indices
    score: float
    lead: float

    @property
    def sure(self) -> bool:
        """Whether the agreement is more than chance."""
        return self.score >= _LEAST_SCORE and self.lead >= _LEAST_LEAD

    def index(self, counted: Indices) -> Indices:
        """(column, row) in the grid of dots counted from anywhere, (n, 2)."""
        found: Indices = counted @ self.symmetry.T + self.shift
        return found


def index_dots(points: Floats) -> tuple[Indices, NDArray[np.intp]]:
    """Count dots (n, 2) along their lattice, from some dot on.

    Returns the counts (k, 2) of those that could be reached, right-handed in the photo, and which
    of the points they are (k,). The lattice may be turned, sheared by less than half, and its steps
    may change slowly.
    """
    nobody = np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.intp)
    if len(points) < 4:
        return nobody
    tree = cKDTree(points)
    middle = np.median(points, axis=0)
    order = np.argsort(np.sum((points - middle) ** 2, axis=1))
    best = nobody
    for seed in order[:: max(1, len(order) // _SEEDS)][:_SEEDS].tolist():
        basis = _basis(points, tree, seed)
        if basis is None:
            continue
        found = _walk(points, tree, seed, basis)
        if len(found) > len(best[1]):
            best = (
                np.array(list(found.keys()), dtype=np.int64),
                np.array(list(found.values()), dtype=np.intp),
            )
        if len(best[1]) > _ENOUGH * len(points):
            break
    return best


def _basis(points: Floats, tree: cKDTree, seed: int) -> tuple[Floats, Floats] | None:
    """Steps to two neighbours of a dot, across each other, right-handed; None where it is alone."""
    neighbours = tree.query(points[seed], k=min(9, len(points)))[1][1:]
    steps = points[neighbours] - points[seed]
    first = steps[0]
    across = np.abs(first[0] * steps[:, 1] - first[1] * steps[:, 0])
    other = np.flatnonzero(across > 0.5 * np.hypot(*first) * np.hypot(steps[:, 0], steps[:, 1]))
    if other.size == 0:
        return None
    second = steps[other[0]]
    if first[0] * second[1] - first[1] * second[0] < 0.0:
        second = -second
    return first, second


def _walk(
    points: Floats, tree: cKDTree, seed: int, basis: tuple[Floats, Floats]
) -> dict[tuple[int, int], int]:
    """Counts -> dots that are reached from a seed, step by step."""
    found = {(0, 0): seed}
    taken = {seed}
    todo = deque([((0, 0), *basis)])
    while todo:
        (i, j), right, down = todo.popleft()
        here = points[found[i, j]]
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            if (i + di, j + dj) in found:
                continue
            step = di * right + dj * down
            distance, dot = tree.query(here + step, distance_upper_bound=_NEAR * np.hypot(*step))
            if not np.isfinite(distance) or dot in taken:
                continue
            found[i + di, j + dj] = int(dot)
            taken.add(int(dot))
            seen = (di + dj) * (points[dot] - here)
            todo.append(((i + di, j + dj), seen if di else right, seen if dj else down))
    return found


def find_lattice_place(cells: Floats, grid_code: NDArray[np.bool_]) -> LatticePlace:
    """The place in the code that counted cells fit best.

    cells : (rows, cols), from -1 (a hole) to 1 (white) amid four counted dots each, NaN where that
        is not known; [0, 0] lies amid the dots (0, 0) and (1, 1).
    grid_code : (rows, cols) bool, holes of the whole panel.
    """
    code = np.where(grid_code, -1.0, 1.0)
    code -= code.mean()
    row, col = np.nonzero(np.isfinite(cells))
    values = cells[row, col]
    total = float(np.abs(values).sum())
    best, runner_up, place = -np.inf, 0.0, (np.eye(2, dtype=np.int64), np.zeros(2, np.int64))
    for numbers in SYMMETRIES:
        symmetry = np.array(numbers, dtype=np.int64)
        # Middles of cells in halves, so that they stay whole numbers whichever way they turn.
        turned = (np.stack([2 * col + 1, 2 * row + 1], axis=-1) @ symmetry.T - 1) // 2
        least = turned.min(axis=0)
        size = turned.max(axis=0) - least + 1
        if (size[::-1] > code.shape).any():
            continue  # the panel has no so many dots this way
        window = np.zeros(size[::-1])
        window[turned[:, 1] - least[1], turned[:, 0] - least[0]] = values
        scores = correlate(code, window, mode="valid")
        down, right = np.unravel_index(int(np.argmax(scores)), scores.shape)
        top = float(scores[down, right])
        scores[down, right] = -np.inf
        runner_up = max(runner_up, min(best, top), float(scores.max()))
        if top > best:
            best = top
            place = symmetry, np.array([right, down], dtype=np.int64) - least
    if total == 0.0 or not np.isfinite(best):
        return LatticePlace(*place, 0.0, 0.0)
    return LatticePlace(*place, best / total, (best - runner_up) / total)
