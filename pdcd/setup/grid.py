"""Cells that are square on the scene, and the part of the projector's picture that they fill."""

from __future__ import annotations

import math

_Size = tuple[int, int]
"""(width, height) in pixels."""

_WISHED_COLUMNS = 64
_LEAST_CELL_PX = 8
_SQUARE = 1.01
"""Largest ratio of the sides of a mask cell that counts as square."""


def choose_field(projector_px: _Size, mask_px: _Size) -> tuple[tuple[int, int, int, int], _Size]:
    """The field, as left, top, width and height in the projector's picture, and rows and columns of
    cells in it.

    The field has the shape of the mask, lies in the middle, and is as large as whole cells allow.
    Cells are squares of whole projector pixels, if possible also of whole mask pixels, and close to
    the usual number.
    """
    (width, height), (mask_width, mask_height) = projector_px, mask_px
    high = min(height, width * mask_height / mask_width)
    most_px = max(_LEAST_CELL_PX, int(min(width, high) // 4))
    found = []
    for cell in range(_LEAST_CELL_PX, most_px + 1):
        cols, rows = int(high * mask_width / mask_height / cell + 1e-9), int(high / cell + 1e-9)
        across, down = mask_width / cols, mask_height / rows
        apart = max(across, down) / min(across, down)
        cost = abs(math.log2(cols / _WISHED_COLUMNS)) + 0.25 * (cols * cell < 0.95 * high)
        cost += 1.0 * (apart > _SQUARE) + 20.0 * (apart - 1.0)
        cost += 0.5 * (across % 1 != 0) + 0.5 * (down % 1 != 0)
        found.append((cost, cell, cols, rows))
    _, cell, cols, rows = min(found)
    wide, tall = cols * cell, rows * cell
    return ((width - wide) // 2, (height - tall) // 2, wide, tall), (rows, cols)
