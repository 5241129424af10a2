"""Pixels of a panel that share one history: they show the same part of a code at the same time.

A pixel shows the part of a code that its centre falls in under the believed map: on a projector a
code cell, or half of one (under sub-shifts), on a mask the strip of a window. Those are some
thousand *sites*, whatever the panel's size; rows that are set later than others have sites of their
own. Site 0 is always black: pixels beside the field, dead lines, and whatever is not a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.bench.tables import PanelConfig
from pdcd.bench.truth import TruePanel
from pdcd.panels.atoms import find_atoms
from pdcd.panels.curve import Curve
from pdcd.panels.frames import BLACK, PIXEL_WINDOW, WHITE, Frames
from pdcd.panels.lattice import SUB_SHIFTS
from pdcd.panels.map import PanelView
from pdcd.panels.patterns import read_pattern_bytes
from pdcd.panels.windows import (
    ATOMS,
    MOVED,
    PLACED,
    UPPER,
    find_window_kind,
    number_strips,
    split_strip_numbers,
)
from pdcd.probing.spans import band_delays_ns

_TILE = 8
"""Sites a side that are multiplied together: near ones meet the same sites of the other panel."""


@dataclass(frozen=True)
class SiteKind:
    """What the sites of a panel depend on besides the panel; few enough kinds to keep the sites.

    patterned : whether the panel shows patterns at all, and not only black and white.

    Under the window `PIXEL_WINDOW` every pixel is a site, and `grid` says nothing.
    """

    grid: tuple[int, int]
    window: str
    patterned: bool


class PanelSites:
    """The sites of one panel.

    image : (height, width) int32, the site of each pixel.
    band : (S,) int32, the band of rows that each site lies in; ascending.
    delay_ns : (bands,) how much later each band's light comes than the first row's.
    tile : (S,) int64, equal for sites that lie near each other.
    """

    def __init__(
        self, panel: PanelView, kind: SiteKind, true: TruePanel, timed: PanelConfig
    ) -> None:
        """`true` is the truth about the panel; `timed` is the true configuration, for its times."""
        self._kind, self._mask = kind, panel.mask
        self._size_px = panel.size_px
        base = self._bases(panel)
        for dead in (true.dead_rows, np.s_[:]), (np.s_[:], true.dead_columns):
            rows, columns = (list(d) if isinstance(d, tuple) else d for d in dead)
            base[rows, columns] = 0
        height = base.shape[0]
        bands = min(timed.scan_bands, height) if timed.scan_s else 1
        band_of_row = np.arange(height) * bands // height
        count = self._count
        self.delay_ns = band_delays_ns(timed.scan_s, bands)
        if bands == 1:
            self.image = base
            self._base = np.arange(count)
            self.band = np.zeros(count, dtype=np.int32)
        else:
            whole = np.where(base > 0, band_of_row[:, None] * np.int64(count) + base, 0)
            found, inverse = np.unique(whole, return_inverse=True)
            if found[0] != 0:  # every pixel lies on the field: black is a site all the same
                found, inverse = np.append(0, found), inverse + 1
            self.image = inverse.reshape(base.shape).astype(np.int32)
            self.band, self._base = (found // count).astype(np.int32), found % count

    def __len__(self) -> int:
        return int(self._base.size)

    @cached_property
    def tile(self) -> NDArray[np.int64]:
        """See the class."""
        across = max(self._shape[1], 1)
        row, column = np.divmod(np.maximum(self._base - 1, 0), across)
        near: NDArray[np.int64] = (row // _TILE) * (across // _TILE + 1) + column // _TILE
        return np.asarray(self.band.astype(np.int64) * (near.max() + 1) + near)

    def in_band(self, band: int) -> slice:
        """The sites of one band."""
        first, end = np.searchsorted(self.band, [band, band + 1])
        return slice(int(first), int(end))

    def levels(self, frames: Frames, row: int, curve: Curve, part: slice) -> Floats:
        """Light that a row of the frames asks for from some sites, 0..1, float64."""
        asked = frames.dual_index if self._mask else frames.primal_index
        index = BLACK if row < 0 else int(asked[row])
        if index in (BLACK, WHITE):
            return np.where(self._base[part] > 0, float(index == WHITE), 0.0)
        patterns = frames.dual_patterns if self._mask else frames.primal_patterns
        rows, cols = frames.lattice
        light = curve.of(np.append(read_pattern_bytes(patterns, index, rows * cols), np.uint8(0)))
        return np.asarray(light[self._cell[int(frames.shift[row]), part]])

    @property
    def pixels(self) -> NDArray[np.int64]:
        """The pixel of each site, (S,), counted row by row; -1 is always black. It is for patterns
        of pixels; where the panel shows none, all pixels count as the first."""
        return self._base - 1

    @property
    def pixel_count(self) -> int:
        """How many values a pattern of pixels has."""
        return self._size_px[0] * self._size_px[1]

    @property
    def _shape(self) -> tuple[int, int]:
        """Rows and columns of the sites of one band."""
        rows, cols = self._kind.grid
        if not self._kind.patterned:
            return 1, 1
        if self._kind.window == PIXEL_WINDOW:
            return self._size_px[1], self._size_px[0]
        kinds = find_window_kind(self._kind.window).kinds
        if kinds == 1:
            return rows, cols
        return (kinds * rows + 1, kinds * cols + 1) if self._mask else (2 * rows, 2 * cols)

    @property
    def _count(self) -> int:
        return 1 + self._shape[0] * self._shape[1]

    def _bases(self, panel: PanelView) -> NDArray[np.int32]:
        """Site of each pixel as if all rows were set at once, (height, width); 0 is black."""
        if self._kind.window == PIXEL_WINDOW:
            width, height = panel.size_px
            if not self._kind.patterned:
                return np.ones((height, width), dtype=np.int32)
            return np.arange(1, width * height + 1, dtype=np.int32).reshape(height, width)
        atom = find_atoms(panel, self._kind.grid)
        outside = atom[..., 0] < 0
        if not self._kind.patterned:
            return np.where(outside, np.int32(0), np.int32(1))
        if self._kind.window == "whole":
            place = atom >> 2
        elif self._mask:
            fine = find_atoms(panel, self._kind.grid, ATOMS)
            place = number_strips(self._kind.window, fine)
        else:
            place = atom >> 1
        found = place[..., 1] * np.int32(self._shape[1]) + place[..., 0]
        found += 1
        found[outside] = 0
        return found

    @cached_property
    def _cell(self) -> NDArray[np.int64]:
        """Cell of the pattern that each site shows under each sub-shift, (4, S); the number after
        the last cell where the site is shut."""
        rows, cols = self._kind.grid
        opening = find_window_kind(self._kind.window)
        more = int(opening.shifted)
        closed = (rows + more) * (cols + more)
        place = np.divmod(np.maximum(self._base - 1, 0), self._shape[1])
        found = np.full((SUB_SHIFTS, len(self)), closed, dtype=np.int64)
        for shift in range(SUB_SHIFTS if more else 1):
            cell, opened = [], self._base > 0
            for at, moved in zip(place, (shift >> 1, shift & 1), strict=True):
                if not more:
                    cell.append(at)
                elif self._mask:
                    strip, number = split_strip_numbers(self._kind.window, at)
                    opened = opened & (strip != (PLACED if moved else MOVED))
                    cell.append(number + moved * (strip == UPPER))
                else:
                    cell.append((at + moved) >> 1)
            found[shift] = np.where(opened, cell[0] * (cols + more) + cell[1], closed)
        return found
