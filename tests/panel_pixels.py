"""Random frames, and every pixel of them on a panel by exact fractions: an oracle of drawing."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.frames.frames import BLACK, WHITE, Frames
from pdcd.frames.lattice import Lattice
from pdcd.frames.patterns import compact, levels_of
from pdcd.frames.pixels import Recorder, Shown

Pixels = NDArray[Any]


def random_frames(
    grid: tuple[int, int], window: str, rows: int, *, grey: bool = False, seed: int = 1
) -> Frames:
    """Rows of random patterns, with blacks and whites among them, under all sub-shifts."""
    rng = np.random.default_rng(seed)
    lattice = Lattice(grid, window)
    levels = rng.random((2, rows, lattice.lattice_cells))
    primal, dual = levels if grey else levels < 0.5
    index = np.arange(rows, dtype=np.int32)
    primal_index, dual_index = index.copy(), index[::-1].copy()
    primal_index[-2:], dual_index[-4:] = (BLACK, WHITE), (WHITE, BLACK, BLACK, WHITE)
    return Frames(
        primal_patterns=compact(primal),
        dual_patterns=compact(dual),
        primal_index=primal_index,
        dual_index=dual_index,
        shift=(index % lattice.fields).astype(np.uint8),
        code=index,
        guard=np.zeros(rows, dtype=np.bool_),
        grid=grid,
        lattice=lattice.shape,
        window=window,
    )


def planned(frames: Frames, row: int, size_px: tuple[int, int], *, mask: bool) -> Pixels:
    """What one row is to put on a panel, (h, w) uint8: pixel by pixel, in exact fractions."""
    width, height = size_px
    index = int((frames.dual_index if mask else frames.primal_index)[row])
    if index in (BLACK, WHITE):
        return np.full((height, width), 255 if index == WHITE else 0, dtype=np.uint8)
    patterns = frames.dual_patterns if mask else frames.primal_patterns
    lattice_rows, lattice_cols = frames.lattice
    levels = levels_of(patterns, index, lattice_rows * lattice_cols)
    levels = levels.reshape(frames.lattice)
    shift, quarter = int(frames.shift[row]), frames.window == "quarter"
    ys, y_open = _axis(height, frames.grid[0], shift >> 1, half=mask and quarter)
    xs, x_open = _axis(width, frames.grid[1], shift & 1, half=mask and quarter)
    image = np.rint(levels[np.ix_(ys, xs)] * 255.0)
    return np.asarray(image * np.outer(y_open, x_open), dtype=np.uint8)


@cache
def _axis(size_px: int, cells: int, bit: int, *, half: bool) -> tuple[list[int], list[bool]]:
    """Cell of every pixel along an axis, and whether the pixel is inside the cell's window."""
    places = [Fraction(x * cells, size_px) + Fraction(bit, 2) for x in range(size_px)]
    inside = [not half or Fraction(1, 4) <= p % 1 < Fraction(3, 4) for p in places]
    return [int(p) for p in places], inside


def from_pictures(
    projector: Sequence[NDArray[np.uint8]], mask: Sequence[NDArray[np.uint8]]
) -> Shown:
    """What was shown, of one (h, w) grey picture of each panel for each refresh, at least one."""
    (ph, pw), (mh, mw) = projector[0].shape, mask[0].shape
    recorder = Recorder((pw, ph), (mw, mh))
    for shown in zip(projector, mask, strict=True):
        recorder.add(*(part.astype(np.uint16) * 3 for part in shown))
    return recorder.shown()
