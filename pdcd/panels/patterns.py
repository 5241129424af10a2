"""Patterns of one panel over L lattice cells: packed bits, or grey levels where bits do not do.

An array of patterns is either (P, ceil(L/8)) uint8, packed by `numpy.packbits` along axis 1, or
(P, L) float32, the level that each cell is sent, over the highest, 0..1. `pdcd.panels.curve` gives
the light of levels; binary patterns do not need it.

Binary patterns can be packed as the 24 bit planes of an RGB picture. DLP controllers in
video-pattern mode take one RGB picture a video refresh and show its 24 bits one after the other,
each for 1/24 of the refresh: 1440 binary patterns a second at 60 Hz. Plane j of a picture is bit
``j % 8``, counted from the least significant, of the colour ``order[j // 8]``. The DLPC350 (TI
DLPU010, "Pattern Number Mapping") counts G0..G7, R0..R7, B0..B7: order "GRB". Others are set up
otherwise, so that the order can be chosen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError

Patterns = NDArray[np.uint8] | NDArray[np.float32]


def pack_bits(on: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """(P, L) bool -> packed patterns."""
    return np.packbits(on, axis=1)


def pack_levels(levels: NDArray[np.float64] | NDArray[np.bool_]) -> Patterns:
    """(P, L) levels 0..1 -> packed bits when they are all 0 or 1, else float32."""
    if levels.dtype == np.bool_ or np.all((levels == 0.0) | (levels == 1.0)):
        return pack_bits(levels.astype(np.bool_))
    return levels.astype(np.float32)


def make_empty_patterns() -> NDArray[np.uint8]:
    """No patterns at all, for panels that are black or white throughout."""
    return np.zeros((0, 0), dtype=np.uint8)


def has_cell_count(patterns: Patterns, cells: int) -> bool:
    """Whether patterns have so many cells; an array without patterns fits any number."""
    width = -(-cells // 8) if patterns.dtype == np.uint8 else cells
    return len(patterns) == 0 or patterns.shape[1:] == (width,)


def to_grey_bytes(levels: Patterns) -> NDArray[np.uint8]:
    """Grey levels as panels of 8 bits get them, uint8 of the same shape: 255 is full light."""
    return np.asarray(np.rint(levels * 255.0), dtype=np.uint8)


def read_pattern_bytes(patterns: Patterns, index: int, cells: int) -> NDArray[np.uint8]:
    """One pattern as panels of 8 bits get it, (L,) uint8: 255 is full light."""
    row = patterns[index]
    if row.dtype == np.uint8:
        return np.unpackbits(row.view(np.uint8), count=cells) * np.uint8(255)
    return to_grey_bytes(row)


def read_pattern_levels(patterns: Patterns, index: int, cells: int) -> NDArray[np.float64]:
    """One pattern as levels, (L,) float64."""
    row = patterns[index]
    if row.dtype == np.uint8:
        row = np.unpackbits(row.view(np.uint8), count=cells)
    return np.asarray(row, dtype=np.float64)


BIT_PLANES = 24
"""Bit planes of one RGB picture."""


def split_planes(words: NDArray[np.uint32], order: str = "GRB") -> NDArray[np.uint8]:
    """Words of 24 bits as an RGB picture.

    Parameters
    ----------
    words : bit j of each is plane j, in the order planes are shown.
    order : which colour holds planes 0-7, 8-15 and 16-23: a permutation of "RGB".

    Returns
    -------
    (..., 3) uint8, red, green and blue last. Raises ConfigError.
    """
    picture = np.empty((*words.shape, 3), dtype=np.uint8)
    for group, colour in enumerate(_colours(order)):
        picture[..., colour] = words >> np.uint32(8 * group)
    return picture


def check_binary(*patterns: Patterns) -> None:
    """Refuse grey levels, which bit planes cannot show. Raises ConfigError."""
    if any(p.dtype != np.uint8 for p in patterns):
        raise ConfigError(
            "bit planes show black and white only, and these patterns have grey levels",
            device="display",
            hint="set display.planes_per_refresh = 1, or take a goal of binary codes",
        )


def _colours(order: str) -> list[int]:
    """Channel (R 0, G 1, B 2) of each group of eight planes. Raises ConfigError."""
    if sorted(order) != ["B", "G", "R"]:
        raise ConfigError(
            f"no order of colours: {order!r}", hint='take "GRB" or another of the six'
        )
    return ["RGB".index(colour) for colour in order]
