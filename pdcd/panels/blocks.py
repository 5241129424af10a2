"""Random blocks that both panels draw alike, so that a camera can see whether they lie alike.

The blocks divide the field as cells do, but are finer: a few quads of the camera. Coarser blocks of
twice, four and eight times the side are mixed in, so that the pattern can be found from far off,
through blur, and in scattered light. No part of the pattern looks like another one, nor like its
mirror image.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from math import gcd

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.panels.map import Map

_Bits = NDArray[np.bool_]

_OCTAVES = (1.0, 1.23, 1.11, 0.97)
"""Weights of blocks of 1, 2, 4 and 8 times the side; no sum of them with any signs is 0."""
_QUADS = 3.0
"""Least number of camera quads to a block's side: a camera sees such blocks sharply."""
_PIXELS = 5.0
"""Least number of projector pixels to it."""
_MOST = 160
"""Most blocks along the longer side of the field: finer ones measure no better."""
_FEWEST = 16
"""Least number of blocks along the shorter side for a pattern that can be found again."""
TOO_FEW = (
    f"the camera has pixels for fewer than {_FEWEST} blocks along a side of the field, "
    f"{_QUADS:g} pixels each"
)


@dataclass(frozen=True)
class BlockPattern:
    """A pattern of (rows, cols) blocks over the field."""

    rows: int
    cols: int

    @classmethod
    def of(cls, sizes_px: tuple[tuple[int, int], ...], quad_px: float) -> BlockPattern | None:
        """Blocks that panels of so many pixels (width, height) can draw, the projector first, and
        that quads of `quad_px` projector pixels can resolve; None if they would be too few."""
        (width, height), *_ = sizes_px
        side = max(_QUADS * quad_px, _PIXELS, max(width, height) / _MOST)
        side = max(side, *(_PIXELS / 2.0 * width / size[0] for size in sizes_px))
        cols, rows = (
            _apart(int(length / side), [size[axis] for size in sizes_px])
            for axis, length in enumerate((width, height))
        )
        return cls(rows, cols) if min(rows, cols) >= _FEWEST else None

    @cached_property
    def bits(self) -> _Bits:
        """(rows, cols), which are lit; the same everywhere and for ever."""
        total = np.zeros((self.rows, self.cols))
        for octave, weight in enumerate(_OCTAVES):
            side = 2**octave
            rows, cols = -(-self.rows // side) + 1, -(-self.cols // side) + 1
            signs = 2.0 * hash_to_bits(f"look for panels {octave}", rows, cols) - 1.0
            large = signs.repeat(side, axis=0).repeat(side, axis=1)
            begin = side // 3  # edges of different octaves must not coincide
            total += weight * large[begin : begin + self.rows, begin : begin + self.cols]
        return np.asarray(total > 0.0)

    def at(self, points: Floats) -> _Bits:
        """Whether points of the field (..., 2), x and y from 0 to 1, are lit; none outside."""
        with np.errstate(invalid="ignore"):
            inside = np.all((points >= 0.0) & (points < 1.0), axis=-1)
        cell = np.where(inside[..., None], points * (self.cols, self.rows), 0.0).astype(np.int64)
        lit: _Bits = self.bits[cell[..., 1], cell[..., 0]] & inside
        return lit

    def drawn(self, panel: Map) -> _Bits:
        """What a panel with this map shows of them, (height, width)."""
        return self.at(panel.centres())


def find_field_pixels(panel: Map) -> _Bits:
    """The pixels of a panel that lie on the field, (height, width)."""
    points = panel.centres()
    with np.errstate(invalid="ignore"):
        return np.asarray(np.all((points >= 0.0) & (points < 1.0), axis=-1))


def hash_to_bits(name: str, rows: int, cols: int) -> _Bits:
    """(rows, cols) bool that look random, and are the same for a name everywhere and for ever,
    unlike the output of a random number generator."""
    count = rows * cols
    drawn = hashlib.shake_256(name.encode()).digest(-(-count // 8))
    bits = np.unpackbits(np.frombuffer(drawn, dtype=np.uint8))[:count]
    return bits.reshape(rows, cols).astype(np.bool_)


def _apart(count: int, lengths: list[int]) -> int:
    """`count` blocks or a few less, whose edges do not coincide regularly with the pixels of any
    panel: rounding edges to whole pixels then cancels on average."""
    while count > _FEWEST and any(gcd(count, length) > 1 for length in lengths):
        count -= 1
    return count
