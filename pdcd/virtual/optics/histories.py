"""Pixels of a panel that show the same in every refresh of one exposure, taken together.

Patterns of pixels (`Frames.of_pixels`) have as many sites as the panel has pixels, yet a photo of
stripes or dots has only as many different histories as it has phases or kinds of dots. So products
are computed for pairs of histories, and each pair of pixels looks up the product of its histories.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.panels.curve import Curve
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.patterns import read_pattern_bytes
from pdcd.virtual.optics.sites import PanelSites

_Numbers = NDArray[np.int64]

KEY_LIMIT = 1 << 54
"""Keys of histories are numbered anew before they grow beyond this."""
_LEVELS = 256
"""Levels of a pixel."""


class Histories:
    """Histories of a panel's sites under some frames; `Products` treats them as sites.

    of : (S,) int64, the history of each site of the panel.
    delay_ns, band, tile : as in `PanelSites`; histories have no place, so all of a band are one
        tile.
    """

    def __init__(self, sites: PanelSites, frames: Frames, *, mask: bool) -> None:
        self._mask = mask
        patterns = frames.dual_patterns if mask else frames.primal_patterns
        pixels = sites.pixels
        # Site 0 and dead lines are black even when all is white: -1 shows nothing.
        key = sites.band.astype(np.int64) * 2 + (pixels >= 0)
        most = 2 * int(sites.delay_ns.size)
        levels = []
        for index in range(len(patterns)):
            shown = read_pattern_bytes(patterns, index, sites.pixel_count)
            level = np.where(pixels >= 0, shown[pixels], np.uint8(0))
            levels.append(level)
            if most * _LEVELS > KEY_LIMIT:
                most, key = _number_anew(key)
            key, most = key * _LEVELS + level, most * _LEVELS
        count, of = _number_anew(key)
        first = np.empty(count, dtype=np.int64)
        first[of[::-1]] = np.arange(of.size)[::-1]
        # In the order of the sites, so that each band's histories lie together.
        order = np.argsort(sites.band[first], kind="stable")
        first = first[order]
        place = np.empty_like(order)
        place[order] = np.arange(order.size)
        self.of: _Numbers = place[of]
        self.band = sites.band[first]
        self.delay_ns = sites.delay_ns
        self.tile: _Numbers = self.band.astype(np.int64)
        self._on = pixels[first] >= 0
        self._levels = [level[first] for level in levels]

    def __len__(self) -> int:
        return int(self.band.size)

    def in_band(self, band: int) -> slice:
        """The histories of one band."""
        first, end = np.searchsorted(self.band, [band, band + 1])
        return slice(int(first), int(end))

    def levels(self, frames: Frames, row: int, curve: Curve, part: slice) -> Floats:
        """Light that a row of the frames asks for from some histories, 0..1, float64."""
        asked = frames.dual_index if self._mask else frames.primal_index
        index = BLACK if row < 0 else int(asked[row])
        if index in (BLACK, WHITE):
            return np.where(self._on[part], float(index == WHITE), 0.0)
        return curve.of(self._levels[index][part])

    def spread(self, sites: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
        """What each history lights, (len, N), summed over what its sites light, (S, N)."""
        each = np.arange(self.of.size)
        ones = np.ones(self.of.size)
        together = scipy.sparse.csr_array((ones, (self.of, each)), shape=(len(self), self.of.size))
        return scipy.sparse.csr_array(together @ sites)


def _number_anew(key: _Numbers) -> tuple[int, _Numbers]:
    """How many different keys there are, and the number of each key among them, in their order."""
    found = np.unique(key)
    return found.size, np.searchsorted(found, key)
