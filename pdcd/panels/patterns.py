"""Patterns of one panel over L lattice cells: packed bits, or grey levels where bits do not do.

An array of patterns is either (P, ceil(L/8)) uint8, packed by `numpy.packbits` along axis 1, or
(P, L) float32, the level that each cell is sent, over the highest, 0..1. What light that is,
`pdcd.panels.curve` knows; binary patterns need none of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Patterns = NDArray[np.uint8] | NDArray[np.float32]


def pack(on: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """(P, L) bool -> packed patterns."""
    return np.packbits(on, axis=1)


def compact(levels: NDArray[np.float64] | NDArray[np.bool_]) -> Patterns:
    """(P, L) levels 0..1 -> packed bits when they are all 0 or 1, else float32."""
    if levels.dtype == np.bool_ or np.all((levels == 0.0) | (levels == 1.0)):
        return pack(levels.astype(np.bool_))
    return levels.astype(np.float32)


def none() -> NDArray[np.uint8]:
    """No patterns at all, for panels that are black or white throughout."""
    return np.zeros((0, 0), dtype=np.uint8)


def fit(patterns: Patterns, cells: int) -> bool:
    """Whether patterns are over so many cells; none at all are over any number."""
    width = -(-cells // 8) if patterns.dtype == np.uint8 else cells
    return len(patterns) == 0 or patterns.shape[1:] == (width,)


def grey_bytes(levels: Patterns) -> NDArray[np.uint8]:
    """Grey levels as panels of 8 bits get them, uint8 of the same shape: 255 is full light."""
    return np.asarray(np.rint(levels * 255.0), dtype=np.uint8)


def bytes_of(patterns: Patterns, index: int, cells: int) -> NDArray[np.uint8]:
    """One pattern as panels of 8 bits get it, (L,) uint8: 255 is full light."""
    row = patterns[index]
    if row.dtype == np.uint8:
        return np.unpackbits(row.view(np.uint8), count=cells) * np.uint8(255)
    return grey_bytes(row)


def levels_of(patterns: Patterns, index: int, cells: int) -> NDArray[np.float64]:
    """One pattern as levels, (L,) float64."""
    row = patterns[index]
    if row.dtype == np.uint8:
        row = np.unpackbits(row.view(np.uint8), count=cells)
    return np.asarray(row, dtype=np.float64)
