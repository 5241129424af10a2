"""Random frames, and every pixel of them on a panel, worked out anew: an oracle of drawing."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.map import Map, PanelView
from pdcd.panels.patterns import pack_levels, read_pattern_levels
from pdcd.panels.pixels import Recorder, ShownPictures
from tests.oracles import GUARDS

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
        primal_patterns=pack_levels(primal),
        dual_patterns=pack_levels(dual),
        primal_index=primal_index,
        dual_index=dual_index,
        shift=(index % lattice.fields).astype(np.uint8),
        code=index,
        guard=np.zeros(rows, dtype=np.bool_),
        grid=grid,
        lattice=lattice.shape,
        window=window,
    )


def upright(size_px: tuple[int, int], *, mask: bool) -> PanelView:
    """A panel that fills the field."""
    return PanelView("mask" if mask else "projector", Map.filling(size_px))


def planned(frames: Frames, row: int, panel: PanelView) -> Pixels:
    """What one row is to put on a panel, (h, w) uint8: pixel by pixel, by where its centre lies.

    In exact fractions where the panel fills the field; else by the map itself.
    """
    places, seen = _cells(panel, frames.grid)
    index = int((frames.dual_index if panel.mask else frames.primal_index)[row])
    if index in (BLACK, WHITE):
        return np.where(seen, 255 if index == WHITE else 0, 0).astype(np.uint8)
    patterns = frames.dual_patterns if panel.mask else frames.primal_patterns
    lattice_rows, lattice_cols = frames.lattice
    levels = read_pattern_levels(patterns, index, lattice_rows * lattice_cols)
    shift, guard = int(frames.shift[row]), GUARDS.get(frames.window)
    moved = places + 0.5 * np.array([shift & 1, shift >> 1])
    cell = np.where(seen[..., None], np.floor(moved), 0).astype(int)
    image = np.rint(levels.reshape(frames.lattice)[cell[..., 1], cell[..., 0]] * 255.0)
    if panel.mask and guard:
        seen = seen & ((moved % 1 >= guard) & (moved % 1 < 1.0 - guard)).all(axis=-1)
    return np.asarray(image * seen, dtype=np.uint8)


@lru_cache(maxsize=8)
def _cells(panel: PanelView, grid: tuple[int, int]) -> tuple[Pixels, Pixels]:
    """Where pixels lie on the field, in cells (h, w, 2), and whether they do (h, w)."""
    if panel.map == Map.filling(panel.size_px):
        # In parts of a cell, rounded down: no window ends in the middle of one.
        axes = [
            [float(Fraction((2 * k + 1) * 16 * cells, size) // 1) / 32.0 for k in range(size)]
            for size, cells in zip(panel.size_px, grid[::-1], strict=True)
        ]
        places = np.stack(np.meshgrid(*axes), axis=-1)
    else:
        places = panel.map.centres() * grid[::-1]
    inside: Pixels = (places >= 0) & (places < grid[::-1])
    return places, np.asarray(inside.all(axis=-1))


def from_pictures(
    projector: Sequence[NDArray[np.uint8]], mask: Sequence[NDArray[np.uint8]]
) -> ShownPictures:
    """What was shown, of one (h, w) grey picture of each panel for each refresh, at least one."""
    (ph, pw), (mh, mw) = projector[0].shape, mask[0].shape
    recorder = Recorder((pw, ph), (mw, mh))
    for shown in zip(projector, mask, strict=True):
        recorder.add(*(part.astype(np.uint16) * 3 for part in shown))
    return recorder.shown()


def pack_words(planes: Pixels) -> NDArray[np.uint32]:
    """Planes (J, ...) bool as the bits of words."""
    words = np.zeros(planes.shape[1:], dtype=np.uint32)
    for bit, plane in enumerate(planes):
        words += np.uint32(2**bit) * plane.astype(np.uint32)
    return words
