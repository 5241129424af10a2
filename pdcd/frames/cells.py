"""Which panel pixels a code cell covers, in whole numbers.

`pdcd.frames.lattice` places cells on a continuous panel; a panel has pixels. Cell k of `cells`
along an axis of `size_px` pixels owns the pixels x with ``floor(x * cells / size_px) == k``: the
pixel goes to the cell that its near edge lies in, so every pixel has one cell and the edges of the
continuous model are met to less than one pixel, exactly where the cells divide the panel. Quarter
windows and half-cell shifts work on the four quarters of each cell, ``floor(4 * x * cells /
size_px)``, by the same rule.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.frames.frames import Frames

Edges = NDArray[np.int32]

SHIFT_BITS = 2
"""A sub-shift moves an axis by half a cell or not at all."""


def check_fit(frames: Frames, size_px: tuple[int, int], *, mask: bool) -> None:
    """Refuse frames with more cells along an axis than the panel has pixels. Raises ConfigError."""
    width, height = size_px
    rows, cols = frames.grid
    if rows > height or cols > width:
        raise ConfigError(
            f"{rows} x {cols} cells do not fit {height} x {width} px",
            device="mask" if mask else "projector",
            hint="use a coarser grid",
        )


def axis_edges(size_px: int, cells: int, lattice_cells: int, *, shifted: bool, half: bool) -> Edges:
    """First and past-the-last pixel of each lattice cell along one axis, (lattice_cells, 2) int32.

    Parameters
    ----------
    size_px, cells : pixels of the panel and cells of the scene along this axis.
    lattice_cells : cells of the pattern: `cells`, or one more under sub-shifts.
    shifted : the lattice is moved half a cell towards the origin.
    half : the cell opens in its central half only (the mask's quarter window).
    """
    cell = np.arange(lattice_cells, dtype=np.int64)
    first, last = (1, 3) if half else (0, 4)
    quarters = np.stack([4 * cell + first, 4 * cell + last], axis=1) - (2 if shifted else 0)
    # x belongs to quarter q or a later one where 4 x cells >= q size: rounded up to a whole pixel.
    edges = -(-quarters * size_px // (4 * cells))
    return np.clip(edges, 0, size_px).astype(np.int32)


def panel_edges(frames: Frames, size_px: tuple[int, int], *, mask: bool) -> Edges:
    """Edges of all cells of one panel, (4, cells, 2) int32: columns, columns shifted, rows, rows
    shifted; the shorter axis is padded by empty cells.

    `size_px` is (width, height). Only the mask has windows; projector cells are whole.
    """
    (rows, cols), (lattice_rows, lattice_cols) = frames.grid, frames.lattice
    half = mask and frames.window == "quarter"
    table = np.zeros((2 * SHIFT_BITS, max(lattice_rows, lattice_cols), 2), dtype=np.int32)
    for shifted in (False, True):
        columns = axis_edges(size_px[0], cols, lattice_cols, shifted=shifted, half=half)
        lines = axis_edges(size_px[1], rows, lattice_rows, shifted=shifted, half=half)
        table[int(shifted), :lattice_cols] = columns
        table[SHIFT_BITS + int(shifted), :lattice_rows] = lines
    return table
