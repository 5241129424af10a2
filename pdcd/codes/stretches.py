"""Codes that light stretches of rows, stretches of columns and scattered cells.

Where there are enough codes, each stretch has one of its own. A mask of grey levels then counts
nearly all far light by stretches, exactly, as no other cell is lit with them. The scattered cells
make up for stretches that reach into the radius: these are few, and as there are stretches along
rows and along columns, cells at the end of one lie amid another.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]

TIMES = 3
"""Each cell is lit along its row, along its column, and among scattered ones."""
SHARE = 0.5
"""Share of the codes that light stretches. More leave too many scattered cells for the others, of
which then hardly any is seen; fewer make stretches long."""
LEAST = 2
"""Stretches in a row or column, at least. Whole rows and columns bring nothing."""
MOST_SCATTERED = 6
"""Scattered cells in a code, at most: with more of them codes that light scattered cells alone err
less of smooth light."""


def parts_of(lattice: tuple[int, int], count: int) -> int:
    """Stretches in each row and in each column, for so many codes; 0 where they bring nothing."""
    rows, cols = lattice
    parts = round(SHARE * count / (rows + cols))
    left = count - parts * (rows + cols)
    return parts if parts >= LEAST and rows * cols <= MOST_SCATTERED * left else 0


def stretched(lattice: tuple[int, int], count: int, parts: int, rng: np.random.Generator) -> Bools:
    """Codes (K, L) that light each cell three times; rows and columns are cut into so many
    stretches, all of the same length but for one cell. Codes come in any order."""
    cells = lattice[0] * lattice[1]
    numbers = np.arange(cells).reshape(lattice)
    codes = np.zeros((count, cells), dtype=np.bool_)
    order = rng.permutation(count)
    stretches = [
        stretch for line in (*numbers, *numbers.T) for stretch in np.array_split(line, parts)
    ]  # fmt: skip
    for code, stretch in zip(order, stretches, strict=False):
        codes[code, stretch] = True
    others = order[len(stretches) :]
    codes[others[np.arange(cells) % others.size], rng.permutation(cells)] = True
    return codes
