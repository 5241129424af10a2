"""Which projector cell each camera cell is matched with: itself, one at a shift, or any one.

On off-axis benches the match depends on the depth. The match of disparity 0 is given by a plane,
through its homography; by a disparity map; by a warp; or it is the cell itself. From there the
disparity counts cells to the right along the row of the projector's cells, which is the epipolar
line of a rectified bench. Matches are places, (row, column), that may lie beyond the grid: then
nothing lights the camera cell at that depth.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy

from pdcd.arrays import Floats, Indices
from pdcd.codes.hadamard import symmetrise_links
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.panels.placing import project_points
from pdcd.probing.wanted import Grid, shift_cells
from pdcd.protocol.plan_summary import Goal
from pdcd.recipes.programs import (
    CodedProgram,
    Program,
    SignedMatrixProgram,
    SignedProgram,
    extend_partners,
    find_inner_program,
)

Partner = Indices | tuple[int, int] | None
"""For all cells: (N,) with -1 for none; a shift (down, right); or None, the cells themselves."""

PARTNER_GUARD_CELLS = 3
"""Cells around a camera cell whose light must not meet the code of its partner. Partners no further
away than that are kept apart from these cells by their distance."""
_OWN = 4.0
"""Light of the cell itself over that of the cell beside it; further away light falls with the
square of the distance."""


def describe_partners(cells: Indices, grid: Grid) -> Partner:
    """The shortest description of the partner of each cell, (N,): a shift or None if it is one.

    A shift can be continued in codes over a lattice larger than the grid.
    """
    here = np.flatnonzero(cells >= 0)
    if not here.size:
        return cells
    n, m = int(here[0]), int(cells[here[0]])
    shift = m // grid[1] - n // grid[1], m % grid[1] - n % grid[1]
    if not np.array_equal(cells, shift_cells(grid, shift)):
        return cells
    return None if shift == (0, 0) else shift


def list_partner_cells(partner: Partner, grid: Grid) -> Indices:
    """The partner of every cell, (N,), -1 for none."""
    if partner is None:
        return np.arange(grid[0] * grid[1])
    return shift_cells(grid, partner) if isinstance(partner, tuple) else partner


def list_distant_partners(program: Program, grid: Grid) -> tuple[Indices | tuple[int, int], ...]:
    """Partners in a program of codes that lie far from the cells themselves."""
    inner = find_inner_program(program)
    found: list[Partner] = []
    if isinstance(inner, CodedProgram):
        found = [inner.partner]
    elif isinstance(inner, SignedProgram):
        found = [partner for _, partner in inner.taps]
    elif isinstance(inner, SignedMatrixProgram):
        found = list(inner.partners)
    return tuple(p for p in found if p is not None and _furthest(p, grid) > PARTNER_GUARD_CELLS)


def _furthest(partner: Indices | tuple[int, int], grid: Grid) -> int:
    """Largest distance, in rows or columns, between a cell and its partner."""
    if isinstance(partner, tuple):
        return max(map(abs, partner))
    n = np.flatnonzero(partner >= 0)
    there = partner[n]
    down, right = there // grid[1] - n // grid[1], there % grid[1] - n % grid[1]
    return int(max(np.abs(down).max(initial=0), np.abs(right).max(initial=0)))


def link_partners(
    partners: tuple[Indices | tuple[int, int], ...], lattice: Lattice
) -> scipy.sparse.csr_array | None:
    """Which code cells of a lattice must not share a column, where the mask shows each cell its
    partners' codes: symmetric (L, L), for `colour_lattice`; None without partners.

    Such a code counts light of all cells that share it with a wrong weight. The strongest light
    comes from the cell itself and from those around it, wherever the partners lie.
    """
    if not partners:
        return None
    cells, (rows, cols) = lattice.lattice_cells, lattice.shape
    first, second, strength = [], [], []
    for partner in partners:
        found = extend_partners(partner, lattice)
        n = np.flatnonzero(found >= 0)
        for down in range(-PARTNER_GUARD_CELLS, PARTNER_GUARD_CELLS + 1):
            for right in range(-PARTNER_GUARD_CELLS, PARTNER_GUARD_CELLS + 1):
                row, col = n // cols + down, n % cols + right
                inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
                first.append(found[n[inside]])
                second.append((row * cols + col)[inside])
                off = down**2 + right**2
                strength.append(np.full(int(inside.sum()), 1.0 / off if off else _OWN))
    places = np.concatenate(first), np.concatenate(second)
    return symmetrise_links(
        scipy.sparse.csr_array((np.concatenate(strength), places), shape=(cells, cells)), cells
    )


NO_MATCH = -(2**40)
"""Row and column of a camera cell that has no match at any depth."""
_SOURCES = ("plane", "disparities", "warp")
"""Sources of the match of disparity 0; one of them at most."""


def find_match_places(goal: Goal, grid: Grid, planes: Mapping[str, Floats]) -> Indices:
    """(row, column) of the match of disparity 0 of each camera cell, (N, 2) int64.

    `planes` holds the goal's arrays (N,) by name. Raises RequestError for a plane that cannot be.
    """
    rows, cols = grid
    row, col = np.divmod(np.arange(rows * cols), cols)
    if goal.plane is not None:
        centres = np.stack([(col + 0.5) / cols, (row + 0.5) / rows], axis=1)
        try:
            x, y = project_points(goal.plane, centres).T
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
        return np.where((warp >= 0)[:, None], there, NO_MATCH)
    return np.stack([row, col], axis=1)


def check_depths(goal: Goal, grid: Grid, planes: Mapping[str, Floats]) -> None:
    """Refuse depths that no cell can have, or that are given twice. Raises RequestError."""
    told = [name for name in _SOURCES if name in planes or getattr(goal, name, None) is not None]
    if len(told) > 1:
        raise RequestError(
            f"both {told[0]} and {told[1]} say where disparity 0 is", hint="give one of them"
        )
    low, high = goal.disparity or (0, 0)
    if low > high:
        raise RequestError(
            f"disparities from {low} to {high} are an empty range", hint="give the lower one first"
        )
    if max(abs(low), abs(high)) >= grid[1] or high - low >= grid[1] - 1:
        raise RequestError(
            f"disparities from {low} to {high} leave a row of {grid[1]} cells nothing else",
            hint=f"take less than {grid[1]} cells to either side, and fewer than {grid[1]} in all",
        )
    place = planes.get("disparities")
    if place is not None and (place.size != grid[0] * grid[1] or not np.isfinite(place).all()):
        return  # faults of an array are reported where all of them are checked
    if "warp" in planes or goal.name == "epipolar":
        return
    found = find_match_places(goal, grid, planes)
    if all((find_matched_cells(found, d, grid) < 0).all() for d in range(low, high + 1)):
        raise RequestError(
            "no camera cell has a match on the projector at these depths",
            hint="disparities count cells to the right, a plane takes 0..1 to 0..1",
        )


def find_matched_cells(place: Indices, disparity: int, shape: Grid) -> Indices:
    """Cells of a grid `disparity` cells to the right of places (n, 2): (n,) int64, -1 beyond the
    grid."""
    row, col = place[:, 0], place[:, 1] + disparity
    inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    return np.where(inside, row * shape[1] + col, -1)


def extend_places(place: Indices, lattice: Lattice) -> Indices:
    """Places of all code cells, (L, 2): those of the grid, continued over its far edges."""
    inner, down, right = lattice.continued
    return np.asarray(place[inner] + np.stack([down, right], axis=1))


def _cell(place: Floats) -> Indices:
    """Number of the cell that a place in cells lies in; far places are only kept far."""
    return np.floor(np.clip(place, -1e9, 1e9)).astype(np.int64)
