"""The exact pixels that a panel must show, for displays that draw with the processor and for tests.

A pixel shows the cell that its centre falls in under the panel's map; of the mask, under quarter
windows, the window. Outside the field a panel is black, whatever is shown. The display process
draws the same on a graphics card by the same whole numbers (`pdcd.panels.atoms`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.panels.atoms import check_cells, find_atoms
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.map import PanelView
from pdcd.panels.patterns import (
    BIT_PLANES,
    check_binary,
    has_cell_count,
    read_pattern_bytes,
    split_planes,
)
from pdcd.panels.windows import ATOMS, GUARDS, find_window_kind

WHITE_BYTE = 255
"""A pixel at full light."""
_KEPT = 8
"""Geometries that are cached: both panels under four sub-shifts."""


def draw(frames: Frames, panel: PanelView, row: int) -> NDArray[np.uint8]:
    """Return what one panel shows at one row of the frames, (height, width) uint8.

    Parameters
    ----------
    frames : what both panels are asked to show.
    panel : which of the two, and where its pixels lie (`pdcd.bench.placed.panels_of`).
    row : row of the frames, 0 <= row < F, or `BLACK`.

    Full light is 255. Levels are not corrected for the panel's response. Raises ConfigError for a
    row that does not exist, for cells finer than pixels or all outside the panel, and for patterns
    of pixels that are not the panel's. A cell beyond the panel's edge is not shown.
    """
    check_fit(frames, panel)
    if row != BLACK and not 0 <= row < len(frames):
        raise ConfigError(f"the frames have no row {row}", device="display")
    shown = frames.dual_index if panel.mask else frames.primal_index
    index = BLACK if row == BLACK else int(shown[row])
    width, height = panel.size_px
    if index == BLACK:
        return np.zeros((height, width), dtype=np.uint8)
    patterns = frames.dual_patterns if panel.mask else frames.primal_patterns
    if frames.of_pixels:
        if index == WHITE:
            return np.full((height, width), WHITE_BYTE, dtype=np.uint8)
        return read_pattern_bytes(patterns, index, width * height).reshape(height, width)
    opening = find_window_kind(frames.window)
    if index == WHITE:
        return np.where(
            _cells(panel, frames.grid, "whole", 0) >= 0, np.uint8(WHITE_BYTE), np.uint8(0)
        )
    shift = int(frames.shift[row]) if opening.shifted else 0
    rows, cols = frames.lattice
    levels = np.append(read_pattern_bytes(patterns, index, rows * cols), np.uint8(0))
    return np.asarray(levels[_cells(panel, frames.grid, frames.window, shift)])


@lru_cache(maxsize=_KEPT)
def _cells(panel: PanelView, grid: tuple[int, int], window: str, shift: int) -> NDArray[np.int32]:
    """Code cell that each pixel shows under a sub-shift, (height, width); -1: black."""
    atom = find_atoms(panel, grid)
    lit = atom[..., 0] >= 0
    opening = find_window_kind(window)
    moved = np.array([shift & 1, shift >> 1], dtype=np.int32)  # across, down
    if panel.mask and opening.shifted:
        at = find_atoms(panel, grid, ATOMS) + ATOMS // 2 * moved
        guard = GUARDS[window]
        lit &= ((at % ATOMS >= guard) & (at % ATOMS < ATOMS - guard)).all(axis=-1)
        cell = at // ATOMS
    else:
        cell = (atom + 2 * moved) >> 2
    cols = grid[1] + opening.shifted
    return np.where(lit, cell[..., 1] * cols + cell[..., 0], -1).astype(np.int32)


def check_fit(frames: Frames, panel: PanelView) -> None:
    """Refuse frames that a panel cannot show: with cells finer than its pixels, or all outside it,
    or with patterns of pixels that are not its own. Raises ConfigError."""
    if not frames.of_pixels:
        check_cells(panel, frames.grid)
        return
    width, height = panel.size_px
    if not has_cell_count(
        frames.dual_patterns if panel.mask else frames.primal_patterns, width * height
    ):
        raise ConfigError(
            f"patterns of pixels that are not the {panel.role}'s {width} x {height}",
            device=panel.role,
            hint="make them for the panel's own size",
        )


def draw_plane_words(frames: Frames, panel: PanelView, rows: Iterable[int]) -> NDArray[np.uint32]:
    """Return up to 24 rows as bits of one word a pixel, (height, width) uint32.

    Bit j is set where `draw` lights ``rows[j]``; bits without a row are 0. For displays whose
    pictures are 24 bit planes: one word is looked up for each pixel, where `draw` would draw 24
    times. Raises ConfigError as `draw` does, also for patterns with grey levels.
    """
    patterns = frames.dual_patterns if panel.mask else frames.primal_patterns
    check_binary(patterns)
    check_fit(frames, panel)
    shown = frames.dual_index if panel.mask else frames.primal_index
    opening = find_window_kind(frames.window)
    width, height = panel.size_px
    cells = width * height if frames.of_pixels else math.prod(frames.lattice)
    tables: dict[tuple[str, int], NDArray[np.uint32]] = {}
    for bit, row in enumerate(rows):
        if bit == BIT_PLANES or (row != BLACK and not 0 <= row < len(frames)):
            what = f"row {row}" if bit < BIT_PLANES else f"more than {BIT_PLANES} rows in a word"
            raise ConfigError(f"the frames have no {what}", device="display")
        index = BLACK if row == BLACK else int(shown[row])
        if index == BLACK:
            continue
        moved = index >= 0 and opening.shifted
        place = (frames.window if index >= 0 else "whole", int(frames.shift[row]) if moved else 0)
        if place not in tables:
            tables[place] = np.zeros(cells + 1, dtype=np.uint32)  # the last one is beside all cells
        lit = 1 if index == WHITE else np.unpackbits(patterns[index], count=cells)
        tables[place][:-1] |= np.asarray(lit, dtype=np.uint32) << np.uint32(bit)
    words = np.zeros((height, width), dtype=np.uint32)
    for place, table in tables.items():
        if frames.of_pixels:
            words |= table[:-1].reshape(height, width)
        else:
            words |= table.take(_cells(panel, frames.grid, *place))
    return words


def draw_planes(
    frames: Frames, panel: PanelView, rows: Iterable[int], order: str = "GRB"
) -> NDArray[np.uint8]:
    """Return the picture that carries up to 24 rows as bit planes, (height, width, 3) uint8.

    `rows` are those of `draw`, in the order they are shown; planes without one are black. `order`
    is that of `pdcd.panels.patterns`. Raises ConfigError, also for patterns with grey levels.
    """
    return split_planes(draw_plane_words(frames, panel, rows), order)
