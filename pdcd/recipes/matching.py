"""Which projector cell each camera cell of an off-axis bench is matched with, depth by depth.

The match of disparity 0 is that of a plane, by its homography; of a disparity map; of a warp; or
the cell itself. From there the disparity counts cells to the right along the row of the projector's
cells, which is the epipolar line of a rectified bench. Matches are places, (row, column), that may
lie beyond the grid: then nothing lights the camera cell at that depth.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import RequestError
from pdcd.panels.between_fields import through
from pdcd.panels.lattice import Lattice
from pdcd.probing.wanted import Indices
from pdcd.protocol.request import Goal

Floats = NDArray[np.float64]
Grid = tuple[int, int]

NOWHERE = -(2**40)
"""Row and column of a camera cell that has no match at any depth."""
SOURCES = ("plane", "disparities", "warp")
"""What tells the match of disparity 0; one of them at most."""


def places_of(goal: Goal, grid: Grid, planes: Mapping[str, Floats]) -> Indices:
    """(row, column) of the match of disparity 0 of each camera cell, (N, 2) int64.

    `planes` holds the goal's arrays (N,) by name. Raises RequestError for a plane that cannot be.
    """
    rows, cols = grid
    row, col = np.divmod(np.arange(rows * cols), cols)
    if goal.plane is not None:
        centres = np.stack([(col + 0.5) / cols, (row + 0.5) / rows], axis=1)
        try:
            x, y = through(goal.plane, centres).T
        except ValueError as err:
            raise RequestError(
                f"plane: {err}",
                hint="give 9 numbers row by row, for (x, y, 1) with 0 to 1 across and down, from "
                "the camera's field to the projector's; 1 0 0 0 1 0 0 0 1 is the field itself",
            ) from err
        return np.stack([_cell(y * rows), _cell(x * cols)], axis=1)
    if "disparities" in planes:
        return np.stack([row, _cell(col + 0.5 + planes["disparities"])], axis=1)
    if "warp" in planes:
        warp = planes["warp"].astype(np.int64)
        there = np.stack(np.divmod(warp, cols), axis=1)
        return np.where((warp >= 0)[:, None], there, NOWHERE)
    return np.stack([row, col], axis=1)


def check_depths(goal: Goal, grid: Grid, planes: Mapping[str, Floats]) -> None:
    """Refuse depths that no cell can have, or that are told twice. Raises RequestError."""
    told = [name for name in SOURCES if name in planes or getattr(goal, name, None) is not None]
    if len(told) > 1:
        raise RequestError(
            f"both {told[0]} and {told[1]} say where disparity 0 is", hint="give one of them"
        )
    low, high = goal.disparity or (0, 0)
    if low > high:
        raise RequestError(
            f"disparities from {low} to {high} are none", hint="give the lower one first"
        )
    if max(abs(low), abs(high)) >= grid[1] or high - low >= grid[1] - 1:
        raise RequestError(
            f"disparities from {low} to {high} leave a row of {grid[1]} cells nothing else",
            hint=f"take less than {grid[1]} cells to either side, and fewer than {grid[1]} in all",
        )
    place = planes.get("disparities")
    if place is not None and (place.size != grid[0] * grid[1] or not np.isfinite(place).all()):
        return  # what is wrong with an array is said where all of them are checked
    if "warp" in planes or goal.name == "epipolar":
        return
    found = places_of(goal, grid, planes)
    if all((matches(found, d, grid) < 0).all() for d in range(low, high + 1)):
        raise RequestError(
            "no camera cell has a match on the projector at these depths",
            hint="disparities count cells to the right, a plane takes 0..1 to 0..1",
        )


def matches(place: Indices, disparity: int, shape: Grid) -> Indices:
    """Cells of a grid at places (n, 2), so many to the right: (n,) int64, -1 beyond the grid."""
    row, col = place[:, 0], place[:, 1] + disparity
    inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    return np.where(inside, row * shape[1] + col, -1)


def on_lattice(place: Indices, lattice: Lattice) -> Indices:
    """Places of all code cells, (L, 2): those of the grid, continued over its far edges."""
    inner, down, right = lattice.continued
    return np.asarray(place[inner] + np.stack([down, right], axis=1))


def _cell(place: Floats) -> Indices:
    """Number of the cell that a place in cells lies in; of far ones only that they are far."""
    return np.floor(np.clip(place, -1e9, 1e9)).astype(np.int64)
