"""Light of single cells in photos whose quads may see several of them.

A mean over a cell's area holds light of its neighbours wherever quads lie across its borders: a
part that is small where a cell has many quads, and a third where it has three a side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.exposed import Errors
from pdcd.sensor.cells import CellMap

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

LEAST_PURE = 0.2
"""Share of a cell's area that quads must see which see nothing else."""
STEPS = 12
"""After so many, a mixture of half a cell with its neighbours is parted to a thousandth."""


class Lit(Protocol):
    """Light of a frame and its variance, (h, w, 3) each."""

    @property
    def light(self) -> Floats:
        """Scene units times seconds."""
        ...

    @property
    def variance(self) -> Errors:
        """Of that."""
        ...


@dataclass(frozen=True)
class Ambient:
    """What gets in through an open mask before a black projector within a second, in scene units
    times seconds, and its variance: (h, w, 3) each."""

    light: Floats
    variance: Floats


def light_of_cells(
    taken: Sequence[Lit], known: Bools, cells: CellMap, wanted: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Light of some cells in K photos and its standard deviation, (K, C, 3) each.

    known : (h, w), quads that count. wanted : (C,), numbers of the cells.

    Of quads that see one cell alone, where each cell has enough of them. Else all quads count, and
    what they mix is parted again, as if cells were of one value each.
    """
    alone = known & cells.single
    share = cells.mean(alone[..., None].astype(np.float64))[wanted]
    pure = bool(share.min(initial=1.0) >= LEAST_PURE)
    used = alone if pure else known
    light = [cells.mean(shot.light, used) for shot in taken]
    error = [cells.error_of_mean(shot.variance, used)[wanted] for shot in taken]
    if not pure:
        light = [_parted(mean, cells, known) for mean in light]
        one = np.zeros((cells.grid[0] * cells.grid[1], 1))
        one[wanted[wanted.size // 2]] = 1.0
        more = float(np.sqrt(np.sum(_parted(one, cells, known) ** 2)))
        error = [more * sigma for sigma in error]
    return np.stack([mean[wanted] for mean in light]), np.stack(error)


def _parted(means: Floats, cells: CellMap, known: Bools) -> Floats:
    """Means over cells (N, C) of quads that mix cells -> values of cells, by Van Cittert's steps:
    what cells of these values would look like is subtracted from what was seen."""
    values = means.copy()
    for _ in range(STEPS):
        values += means - cells.mean(cells.spread(values), known)
    return values
