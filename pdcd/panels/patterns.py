"""Patterns of one panel over L lattice cells: packed bits, or grey levels where bits do not do.

An array of patterns is either (P, ceil(L/8)) uint8, packed by `numpy.packbits` along axis 1, or
(P, L) float32, the level that each cell is sent, over the highest, 0..1. What light that is,
`pdcd.panels.curve` knows; binary patterns need none of it.

Binary patterns packed as the 24 bit planes of an RGB picture.

DLP controllers in video-pattern mode take one RGB picture a video refresh and show its 24 bits one
after the other, each for 1/24 of the refresh: 1440 binary patterns a second at 60 Hz. Plane j of a
picture is bit ``j % 8``, counted from the least significant, of the colour ``order[j // 8]``. The
DLPC350 (TI DLPU010, "Pattern Number Mapping") counts G0..G7, R0..R7, B0..B7: order "GRB". Others
are set up otherwise, so that the order can be chosen.
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
    """Whether patterns are over so many cells; none at all are over any number."""
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


def pack_planes(planes: NDArray[np.bool_], order: str = "GRB") -> NDArray[np.uint8]:
    """Up to 24 binary patterns as one RGB picture.

    Parameters
    ----------
    planes : (J, ...) bool, J <= 24
        Patterns in the order they are to be shown; those that are missing at the end are black.
        Axes after the first (cells, or rows and columns of a panel) are kept.
    order : which colour holds planes 0-7, 8-15 and 16-23: a permutation of "RGB".

    Returns
    -------
    (..., 3) uint8, red, green and blue last. Raises ConfigError.
    """
    colours = _colours(order)
    if len(planes) > BIT_PLANES:
        raise ConfigError(
            f"{len(planes)} planes do not fit one picture", hint=f"give at most {BIT_PLANES}"
        )
    full = np.zeros((BIT_PLANES, *planes.shape[1:]), dtype=np.uint8)
    full[: len(planes)] = planes
    weights = (1 << np.arange(8)).astype(np.uint8)
    values = np.tensordot(weights, full.reshape(3, 8, *planes.shape[1:]), axes=(0, 1))
    picture = np.empty((*planes.shape[1:], 3), dtype=np.uint8)
    picture[..., colours] = np.moveaxis(values, 0, -1)
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
