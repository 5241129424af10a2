"""Photos of stripes, divided by white and averaged over whole periods."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from pdcd.arrays import Bools, Floats

_BOXES = 3
"""Box filters of one period each: together they leave 0.0007 of stripes that are 10 % longer."""
_BOX_NOISE = 0.55
"""Sum of the squared weights of three boxes along an axis, times their length: 11 / 20."""
_WHOLE = 0.995
"""Share of lit quads that a place needs around it, by weight: stripes that are cut off shift the
offset, at 0.98 by 0.04 px of 16."""


class StripeAverager:
    """Averages photos of one size over blocks of quads, then over stripes.

    lit : (h, w), the quads that count. white : (h, w) light with both panels white.
    period_quads : of the stripes. block : quads along a side of a block.
    """

    def __init__(self, lit: Bools, white: Floats, period_quads: float, block: int) -> None:
        self.block, self.period_quads = block, period_quads
        self._lit, self._per_white = lit, np.where(lit, 1.0 / np.where(lit, white, 1.0), 0.0)
        self.count = self._summed(lit.astype(np.float64))
        self._around = self._boxed(self.count)

    def over_white(self, light: Floats, power: int = 1) -> Floats:
        """Light (h, w) over white, or its variance over white squared (``power`` 2), summed over
        the lit quads of each block."""
        # Quads that are not lit may hold anything, even NaN.
        seen = np.where(self._lit, light, 0.0)
        return self._summed(seen * self._per_white**power)

    def smooth(self, summed: Floats) -> Floats:
        """Sums of blocks -> means over stripes around each block, per lit quad."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self._boxed(summed) / self._around)

    @property
    def noise(self) -> float:
        """Factor from the standard deviation of one quad to that of an average over stripes."""
        return _BOX_NOISE / self.period_quads

    def places(self, apart_quads: float) -> Floats:
        """A lattice of places with lit quads all around, (n, 2) in quads."""
        step = max(1, round(apart_quads / self.block))
        full = float(self.block**2)
        # The boxes must lie within the photo, and within what is lit.
        good = self._inside() & (self._around >= _WHOLE * full)
        rows, cols = np.nonzero(good[step // 2 :: step, step // 2 :: step])
        middle = np.stack([cols, rows], axis=-1) * step + step // 2
        return np.asarray((middle + 0.5) * self.block)

    def at(self, of_blocks: Floats, places: Floats) -> Floats:
        """Values of blocks (n,) at places (n, 2) in quads: those of the blocks that the places lie
        in."""
        cols, rows = np.floor(places / self.block).astype(np.intp).T
        return np.asarray(of_blocks[rows, cols])

    def _summed(self, of_quads: Floats) -> Floats:
        """Sums over blocks; quads beyond the last whole block are left out."""
        rows, cols = (side // self.block for side in of_quads.shape)
        whole = of_quads[: rows * self.block, : cols * self.block]
        return np.asarray(whole.reshape(rows, self.block, cols, self.block).sum(axis=(1, 3)))

    def _boxed(self, of_blocks: Floats) -> Floats:
        """Three boxes of one period along either axis; beyond the photo all is 0."""
        found = of_blocks
        for length in self._lengths():
            found = ndimage.uniform_filter(found, length, mode="constant")
        return np.asarray(found)

    def _lengths(self) -> list[int]:
        """Whole numbers of blocks, one period on average; they are odd, so that boxes stay
        centred."""
        period = self.period_quads / self.block
        below = int(np.floor((period - 1.0) / 2.0)) * 2 + 1
        above = round((_BOXES * period - _BOXES * below) / 2.0)
        return [below + 2 * (index < above) for index in range(_BOXES)]

    def _inside(self) -> Bools:
        """Blocks whose boxes lie within the photo."""
        reach = sum(self._lengths()) // 2 + 1
        inside = np.zeros(self.count.shape, dtype=np.bool_)
        inside[reach:-reach, reach:-reach] = True
        return inside
