"""The exact pixels that a panel must show, for displays that draw with the processor and for tests.

The display process draws the same rectangles, out of the same tables of cell edges, on a graphics
card.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.frames.bitplanes import check_binary, pack_planes
from pdcd.frames.cells import SHIFT_BITS, Edges, check_fit, panel_edges
from pdcd.frames.frames import BLACK, WHITE, Frames
from pdcd.frames.patterns import bytes_of

FULL = 255
"""A pixel at full light."""


def draw(frames: Frames, size_px: tuple[int, int], row: int, *, mask: bool) -> NDArray[np.uint8]:
    """Return what one panel shows at one row of the frames, (height, width) uint8.

    Parameters
    ----------
    frames : what both panels are asked to show.
    size_px : (width, height) of the panel.
    row : row of the frames, 0 <= row < F, or `BLACK`.
    mask : whether the panel is the mask, or else the projector.

    Full light is 255. Levels are not corrected for the panel's response. Raises ConfigError for a
    row that there is not, and where there are more cells than pixels.
    """
    check_fit(frames, size_px, mask=mask)
    width, height = size_px
    if row != BLACK and not 0 <= row < len(frames):
        raise ConfigError(f"the frames have no row {row}", device="display")
    shown = frames.dual_index if mask else frames.primal_index
    index = BLACK if row == BLACK else int(shown[row])
    if index < 0:
        return np.full((height, width), FULL if index == WHITE else 0, dtype=np.uint8)
    rows, cols = frames.lattice
    patterns = frames.dual_patterns if mask else frames.primal_patterns
    cells = np.zeros((rows + 1, cols + 1), dtype=np.uint8)  # the last ones are beside all cells
    cells[:rows, :cols] = bytes_of(patterns, index, rows * cols).reshape(rows, cols)
    edges, shift = panel_edges(frames, size_px, mask=mask), int(frames.shift[row])
    across = _cell_of(edges[shift & 1, :cols], width)
    down = _cell_of(edges[SHIFT_BITS + (shift >> 1), :rows], height)
    return np.asarray(cells[np.ix_(down, across)])


def draw_planes(
    frames: Frames, size_px: tuple[int, int], rows: Iterable[int], *, mask: bool, order: str = "GRB"
) -> NDArray[np.uint8]:
    """Return the picture that carries up to 24 rows as bit planes, (height, width, 3) uint8.

    `rows` are those of `draw`, in the order they are shown; planes without one are black. `order`
    is that of `pdcd.frames.bitplanes`. Raises ConfigError, also for patterns with grey levels.
    """
    check_binary(frames.dual_patterns if mask else frames.primal_patterns)
    planes = [draw(frames, size_px, row, mask=mask) > 0 for row in rows]
    none = np.zeros((0, size_px[1], size_px[0]), dtype=np.bool_)
    return pack_planes(np.stack(planes) if planes else none, order)


def _cell_of(edges: Edges, size_px: int) -> NDArray[np.int64]:
    """Which cell each pixel of an axis lies in, (size_px,); -1 beside all cells."""
    cell = np.full(size_px, -1, dtype=np.int64)
    for number, (first, end) in enumerate(edges.tolist()):
        cell[first:end] = number
    return cell
