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


@dataclass(frozen=True, eq=False)
class Apart:
    """How cells are told apart: which quads count (h, w), and whether what they mix is parted."""

    cells: CellMap
    known: Bools
    used: Bools
    pure: bool

    def mean(self, light: Floats) -> Floats:
        """Light of quads (h, w, C) -> of cells (N, C)."""
        mean = self.cells.mean(light, self.used)
        return mean if self.pure else _parted(mean, self.cells, self.known)

    def error(self, variance: NDArray[np.floating], middle: int) -> Floats:
        """Variances of quads (h, w, C) -> standard deviation of `mean`, (N, C). Where cells are
        parted noise grows as much everywhere as at the cell `middle`."""
        error = self.cells.error_of_mean(variance, self.used)
        if self.pure:
            return error
        one = np.zeros((self.cells.grid[0] * self.cells.grid[1], 1))
        one[middle] = 1.0
        more = float(np.sqrt(np.sum(_parted(one, self.cells, self.known) ** 2)))
        return more * error


def told_apart(known: Bools, cells: CellMap, wanted: NDArray[np.int64]) -> Apart:
    """How the light of some cells is told from that of their neighbours.

    By quads that see one cell alone, where each cell has enough of them. Else all quads count, and
    what they mix is parted again, as if cells were of one value each.

    known : (h, w), quads that count. wanted : (C,), numbers of the cells.
    """
    alone = known & cells.single
    share = cells.mean(alone[..., None].astype(np.float64))[wanted]
    pure = bool(share.min(initial=1.0) >= LEAST_PURE)
    return Apart(cells, known, alone if pure else known, pure)


def light_of_cells(
    taken: Sequence[Lit], known: Bools, cells: CellMap, wanted: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Light of some cells in K photos and its standard deviation, (K, C, 3) each, told from that of
    their neighbours.

    known : (h, w), quads that count. wanted : (C,), numbers of the cells.
    """
    apart = told_apart(known, cells, wanted)
    light = [apart.mean(shot.light)[wanted] for shot in taken]
    middle = int(wanted[wanted.size // 2])
    error = [apart.error(shot.variance, middle)[wanted] for shot in taken]
    return np.stack(light), np.stack(error)


def _parted(means: Floats, cells: CellMap, known: Bools) -> Floats:
    """Means over cells (N, C) of quads that mix cells -> values of cells, by Van Cittert's steps:
    what cells of these values would look like is subtracted from what was seen."""
    values = means.copy()
    for _ in range(STEPS):
        values += means - cells.mean(cells.spread(values), known)
    return values
