"""Windows of the mask: which part of a cell opens, and when.

Along an axis a window takes the middle of its cell: all of it ("whole"), one half ("quarter": a
quarter of the area, the paper's), or more, up to seven eighths. Except with whole cells every code
is shown under four sub-shifts, so that windows serve every place. Windows of more than half a cell
overlap with those that are moved by half a cell: a place then opens under one sub-shift or under
two of an axis, and the photo is divided by how often it did.

Along an axis a cell falls into *strips*, each of which opens under its own shifts:

    |- 1 -|-- 2 --|--- 0 ---|-- 3 --|- 1 -|      0: in place    1: when moved    2, 3: both
    0     g      w/2      1-w/2    1-g    1      w: side of the window, g = (1 - w) / 2

The strips 1 of two neighbouring cells are one. Half windows have w/2 = g, and no strips 2 and 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.map import PanelView

ATOMS = 16
"""Equal parts of a cell along an axis on whose borders every window ends."""

GUARDS: dict[str, int] = {"quarter": 4, "side-5/8": 3, "side-3/4": 2, "side-7/8": 1}
"""Atoms from the edge of a cell to that of its window, for windows that need sub-shifts; widest
guard first."""

_NEAR_PX = 1e-6
"""Distance within which an edge counts as lying on that of a pixel."""

PLACED, MOVED, LOWER, UPPER = range(4)
"""Strips, as in the drawing above."""


@dataclass(frozen=True)
class WindowKind:
    """One kind of window.

    guard : distance from the edge of a cell to that of its window, in cells.
    kinds : strips along an axis.
    """

    name: str
    guard: float
    kinds: int

    @property
    def shifted(self) -> bool:
        """Whether codes are shown under four sub-shifts."""
        return self.name != "whole"

    @property
    def side(self) -> float:
        """Share of a cell's side that opens."""
        return 1.0 - 2.0 * self.guard

    @property
    def area(self) -> float:
        """Share of a cell that opens under one sub-shift."""
        return self.side**2

    def strip(self, place: float) -> int:
        """The strip at a place in a cell, from 0 to 1; 0 for whole cells, which have one."""
        if not self.shifted:
            return PLACED
        if place < self.guard or place >= 1.0 - self.guard:
            return MOVED
        if 0.5 * self.side <= place < 1.0 - 0.5 * self.side:
            return PLACED
        return LOWER if place < 0.5 else UPPER

    def opens(self, strip: int, moved: int) -> bool:
        """Whether a strip opens in place (0), or when cells are moved by half (1)."""
        if not self.shifted:
            return True
        return strip != (PLACED if moved else MOVED)

    def further(self, strip: int, moved: int) -> int:
        """How many code cells further than its number a strip shows when moved. The number is that
        of the cell it lies in; for `MOVED` strips that of the code cell they show."""
        return int(strip == UPPER and moved == 1)


@lru_cache
def find_window_kind(name: str) -> WindowKind:
    """Windows by their name; frames of pixels have whole cells."""
    if name not in GUARDS:
        return WindowKind("whole", 0.0, 1)
    guard = GUARDS[name]
    return WindowKind(name, guard / ATOMS, 2 if guard == ATOMS // 4 else 4)


def is_on_whole_pixels(name: str, panel: PanelView, grid: tuple[int, int]) -> bool:
    """Whether all strips of all cells end at the edges of a panel's pixels.

    Overlapping windows need it: a pixel more or less in one is light that is not counted. Half
    windows and whole cells do not, as every pixel is in one window.
    """
    if find_window_kind(name).kinds < 4:
        return True
    map_ = panel.map
    if not map_.is_upright:
        return False
    for axis, cells in enumerate(grid[::-1]):
        points = np.full((ATOMS * cells + 1, 2), 0.5)
        points[:, axis] = np.arange(ATOMS * cells + 1) / (ATOMS * cells)
        edges = map_.from_field(points)[:, axis]
        number = number_strips(name, np.arange(ATOMS * cells, dtype=np.int32))
        ends = edges[1:-1][np.diff(number) > 0]
        if np.abs(ends - np.rint(ends)).max() > _NEAR_PX:
            return False
    return True


def number_strips(name: str, atom: NDArray[np.int32]) -> NDArray[np.int32]:
    """Number of the strip that each atom lies in along an axis, for windows under sub-shifts.

    atom : whole numbers, `ATOMS` to a cell, from the field's edge. Strips are counted along the
    axis, from the `MOVED` one at the field's edge; each cell adds as many as there are kinds.
    """
    guard = GUARDS[name]
    side = ATOMS - 2 * guard
    inner = [guard, ATOMS - guard]
    if guard != ATOMS // 4:
        inner = [guard, side // 2, ATOMS - side // 2, ATOMS - guard]
    place = np.arange(ATOMS)
    of_place = np.searchsorted(inner, place, side="right").astype(np.int32)
    found = of_place.take(atom % ATOMS)
    found += np.int32(len(inner)) * (atom // ATOMS)
    return found


def split_strip_numbers(
    name: str, number: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Kind of each strip, and number of its code cell; of `number_strips`."""
    kinds = find_window_kind(name).kinds
    cell, at = np.divmod(number, kinds)
    order = [MOVED, PLACED] if kinds == 2 else [MOVED, LOWER, PLACED, UPPER]
    return np.array(order)[at], cell
