"""Which projector cell each camera cell is matched with: itself, one at a shift, or any one."""

from __future__ import annotations

import numpy as np
import scipy

from pdcd.codes.linked import symmetric
from pdcd.panels.lattice import Lattice
from pdcd.probing.wanted import Grid, Indices, shifted
from pdcd.recipes.programs import (
    Coded,
    Program,
    Signed,
    SignedMatrix,
    on_lattice,
    within,
)

Partner = Indices | tuple[int, int] | None
"""Of all cells: (N,) with -1 for none; a shift (down, right); or None, the cells themselves."""

REACH = 3
"""Cells around a camera cell whose light must not meet the code of its partner. Partners no further
off than that are kept apart from these by their distance."""
OWN = 4.0
"""Light of the cell itself over that of the cell beside it; further off it falls with the square of
the distance."""


def partner_of(cells: Indices, grid: Grid) -> Partner:
    """The shortest way to say which partner each cell has, (N,): a shift or None where it is one.

    Codes over a lattice larger than the grid know how to go on with a shift.
    """
    here = np.flatnonzero(cells >= 0)
    if not here.size:
        return cells
    n, m = int(here[0]), int(cells[here[0]])
    shift = m // grid[1] - n // grid[1], m % grid[1] - n % grid[1]
    if not np.array_equal(cells, shifted(grid, shift)):
        return cells
    return None if shift == (0, 0) else shift


def cells_of(partner: Partner, grid: Grid) -> Indices:
    """The partner of every cell, (N,), -1 for none."""
    if partner is None:
        return np.arange(grid[0] * grid[1])
    return shifted(grid, partner) if isinstance(partner, tuple) else partner


def far_partners(program: Program, grid: Grid) -> tuple[Indices | tuple[int, int], ...]:
    """Partners in a program of codes that lie away from the cells themselves."""
    inner = within(program)
    found: list[Partner] = []
    if isinstance(inner, Coded):
        found = [inner.partner]
    elif isinstance(inner, Signed):
        found = [partner for _, partner in inner.taps]
    elif isinstance(inner, SignedMatrix):
        found = list(inner.partners)
    return tuple(p for p in found if p is not None and _furthest(p, grid) > REACH)


def _furthest(partner: Indices | tuple[int, int], grid: Grid) -> int:
    """Cells, in rows or columns, between a cell and its partner, at the most."""
    if isinstance(partner, tuple):
        return max(map(abs, partner))
    n = np.flatnonzero(partner >= 0)
    there = partner[n]
    down, right = there // grid[1] - n // grid[1], there % grid[1] - n % grid[1]
    return int(max(np.abs(down).max(initial=0), np.abs(right).max(initial=0)))


def partner_links(
    partners: tuple[Indices | tuple[int, int], ...], lattice: Lattice
) -> scipy.sparse.csr_array | None:
    """Which code cells of a lattice must not share a column, where the mask shows each cell its
    partners' codes: symmetric (L, L), for `colour_lattice`; None without partners.

    Such a code is counted wrong with the light of all cells that share it. The strongest light
    comes from the cell itself and from those around it, wherever the partners lie.
    """
    if not partners:
        return None
    cells, (rows, cols) = lattice.lattice_cells, lattice.shape
    first, second, strength = [], [], []
    for partner in partners:
        found = on_lattice(partner, lattice)
        n = np.flatnonzero(found >= 0)
        for down in range(-REACH, REACH + 1):
            for right in range(-REACH, REACH + 1):
                row, col = n // cols + down, n % cols + right
                inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
                first.append(found[n[inside]])
                second.append((row * cols + col)[inside])
                off = down**2 + right**2
                strength.append(np.full(int(inside.sum()), 1.0 / off if off else OWN))
    places = np.concatenate(first), np.concatenate(second)
    return symmetric(
        scipy.sparse.csr_array((np.concatenate(strength), places), shape=(cells, cells)), cells
    )
