"""Which quarter of which cell each pixel of a panel lies in, in whole numbers.

`pdcd.panels.lattice` places cells on a continuous field; a panel has pixels, and its map says where
their centres lie. A cell of the field is divided into four quarters along each axis, its *atoms*.
No cell, no cell moved by half its width, and no quarter window ends within an atom. So one whole
number along each axis is all that drawing must know of a pixel, whatever is shown. These numbers
are made here, once for each geometry; the graphics card only copies by them.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.panels.map import Map, PanelView
from pdcd.panels.map_soundness import find_fewest_pixels, is_field_covered

_Atoms = NDArray[np.int32]

ATOMS_PER_CELL = 4
"""Atoms of a cell along an axis."""
OUTSIDE = -1
"""Atom of a pixel whose centre lies outside the field."""
NEAR = 1e-9
"""Distance in atoms from an edge within which a centre counts as lying on it: rounding error."""
BLOCK_PX = 1 << 17
"""Pixels whose places are computed at a time, to bound the memory."""
_SURE_PX = 2.0
"""Pixels along a cell's side from which at least one has its centre in it, however the cell is
turned: the circle in a square of sqrt(2) holds one; the rest is for distortion within a cell."""
_KEPT = 6
"""Geometries that are cached: two panels, each with two grids, and the mask in fine atoms."""


@lru_cache(maxsize=_KEPT)
def find_atoms(panel: PanelView, grid: tuple[int, int], per_cell: int = ATOMS_PER_CELL) -> _Atoms:
    """Return the atom that the centre of each pixel lies in, (height, width, 2) int32, read-only.

    Parameters
    ----------
    panel : the panel; its map places the pixels.
    grid : (rows, cols) of cells that divide the field.
    per_cell : atoms of a cell along an axis; `pdcd.panels.windows.ATOMS` for windows larger than
        half a cell.

    The last axis is (across, down). Inside the field a number is ``floor(4 * x * cells)`` with x
    the place on the field, 0 to 4 cells - 1; both are `OUTSIDE` where the centre lies outside the
    field. A centre on an edge belongs to the atom beyond it, further right or down. Then, along an
    axis, the cell is ``atom >> 2``; of a projector moved towards the origin by half a cell
    ``(atom + 2) >> 2``; and quarter windows of the mask are numbered ``(atom + 1) >> 1``: odd ones
    open when the cells are in place, even ones when they are moved, for the pattern's cell
    ``number >> 1`` either way.
    """
    width, height = panel.size_px
    found = np.empty((height, width, 2), dtype=np.int32)
    axes = _axes(panel.map, grid, per_cell)
    if axes is not None:
        found[..., 0], found[..., 1] = axes[0], axes[1][:, None]
    else:
        step = max(1, BLOCK_PX // width)
        x = np.arange(width) + 0.5
        for first in range(0, height, step):
            y = np.arange(first, min(first + step, height)) + 0.5
            points = np.stack(np.meshgrid(x, y), axis=-1)
            places = panel.map.to_field(points)
            for axis, cells in enumerate(grid[::-1]):
                found[first : first + y.size, :, axis] = _floor(places[..., axis], cells, per_cell)
    found[(found < 0).any(axis=-1)] = OUTSIDE
    found.flags.writeable = False
    return found


@lru_cache(maxsize=2 * _KEPT)
def find_shown_cells(panel: PanelView, grid: tuple[int, int]) -> NDArray[np.bool_]:
    """Which cells of a grid any pixel of the panel shows, (rows, cols), read-only. Cells beyond the
    panel's edge are not shown, nor those that are smaller than its pixels and lie between them.

    This takes no time where panel and grid are upright, or where cells are so large that none can
    miss all pixels of a panel that covers the field; else `find_atoms` is needed.
    """
    axes = _axes(panel.map, grid)
    if axes is not None:
        shown = np.outer(*(_seen(a, n) for a, n in zip(axes[::-1], grid, strict=True)))
    elif is_field_covered(panel.map) and (find_fewest_pixels(panel.map, grid) or 0.0) >= _SURE_PX:
        shown = np.ones(grid, dtype=np.bool_)
    else:
        cell = find_atoms(panel, grid) // ATOMS_PER_CELL
        inside = cell[cell[..., 0] >= 0]
        shown = np.zeros(grid, dtype=np.bool_)
        shown[inside[:, 1], inside[:, 0]] = True
    shown.flags.writeable = False
    return shown


def check_cells(panel: PanelView, grid: tuple[int, int]) -> None:
    """Refuse a grid that is finer than the panel's pixels, or none of whose cells it shows. Raises
    ConfigError.

    Cells beyond the panel's edge may have no pixel, as no panel covers the field exactly: these
    stay dark, and nothing is known there.
    """
    shown = find_shown_cells(panel, grid)
    finer = (find_fewest_pixels(panel.map, grid) or 0.0) < 1.0 - NEAR
    if shown.all() or (shown.any() and not finer):
        return
    (rows, cols), (width, height) = grid, panel.size_px
    missing = int(shown.size - np.count_nonzero(shown))
    row, col = np.argwhere(~shown)[0].tolist()
    raise ConfigError(
        f"{missing} of {rows} x {cols} cells have no pixel on the {panel.role}'s "
        f"{height} x {width} px, the first in row {row}, column {col}",
        device=panel.role,
        hint="use a coarser grid, or place the panel so that it covers the field",
    )


def _axes(
    map_: Map, grid: tuple[int, int], per_cell: int = ATOMS_PER_CELL
) -> tuple[_Atoms, _Atoms] | None:
    """Atoms of the columns (w,) and of the rows (h,); None where they depend on each other."""
    if not map_.is_upright:
        return None
    found = []
    for axis, (size, cells) in enumerate(zip(map_.size_px, grid[::-1], strict=True)):
        points = np.zeros((size, 2))
        points[:, axis] = np.arange(size) + 0.5
        found.append(_floor(map_.to_field(points)[:, axis], cells, per_cell))
    return found[0], found[1]


def _floor(places: NDArray[np.float64], cells: int, per_cell: int) -> _Atoms:
    """Places along an axis of the field -> atoms; `OUTSIDE` outside the field and for NaN."""
    count = per_cell * cells
    atom = np.floor(places * count + NEAR)
    inside = (atom >= 0) & (atom < count)
    return np.where(inside, atom, OUTSIDE).astype(np.int32)


def _seen(atom: _Atoms, cells: int) -> NDArray[np.bool_]:
    """Which cells of an axis have a pixel, (cells,)."""
    found = np.zeros(cells, dtype=np.bool_)
    found[atom[atom >= 0] // ATOMS_PER_CELL] = True
    return found
