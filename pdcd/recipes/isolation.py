"""Path isolation: one lit and one open cell at a time, the baseline that codes are compared with.

Figure 7 of the paper (left and middle). Any wanted matrix comes out exactly, but each path has the
light of one slot in very many.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.probing.wanted import WantedMatrix
from pdcd.recipes.programs import LevelPairs, Program
from pdcd.recipes.recipe import Recipe
from pdcd.words import FamilyName

ISOLATION_FAMILIES: tuple[FamilyName, ...] = ("isolation", "confocal")
"""Names by which a request asks for all pairs of cells, or only for those that are wanted."""

_MAX_LEVELS = 50_000_000
"""Most levels (pairs times cells) of one panel that are made; bounds the memory."""

_BLOCK = 256
"""Rows of the wanted matrix that are processed together."""


@dataclass(frozen=True, eq=False)
class Isolation:
    """One half of a wanted matrix, entry by entry: mask cell n opens while projector cell m shows
    the positive (or negative) part of the entry, over the largest entry.

    Both halves open the same cells for the same time, so what leaks through black panels cancels
    in their difference. With `confocal` only entries that are not 0 have a slot, else all do.
    """

    wanted: WantedMatrix
    positive: bool
    confocal: bool
    coded: bool = False
    p: float = 0.5

    def count(self) -> int:
        """Number of pairs, without making them."""
        if not self.confocal:
            return self.wanted.cells**2
        return max(1, sum(int(np.count_nonzero(rows)) for _, rows in _blocks(self.wanted)))

    def pairs(self, bits: Bools, lattice: Lattice) -> LevelPairs:
        """One pair an entry, row by row; `bits` is not used."""
        camera, projector, entry = self._entries()
        if not entry.any():  # a single cell has no indirect light
            nothing = np.zeros((1, lattice.lattice_cells), np.bool_)
            return nothing, nothing
        level = np.maximum(entry if self.positive else -entry, 0.0) / np.abs(entry).max()
        slots = np.arange(entry.size)
        lit = np.zeros((entry.size, lattice.lattice_cells))
        opened = np.zeros(lit.shape, np.bool_)
        lit[slots, projector] = level
        opened[slots, camera] = True
        return lit, opened

    def _entries(self) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
        """(n, m, entry) of every slot."""
        camera, projector, entries = [], [], []
        for start, rows in _blocks(self.wanted):
            n, m = np.nonzero(rows if self.confocal else np.ones_like(rows))
            camera.append(n + start)
            projector.append(m)
            entries.append(rows[n, m])
        return np.concatenate(camera), np.concatenate(projector), np.concatenate(entries)


def use_path_isolation(recipe: Recipe, family: FamilyName) -> Recipe:
    """The same recipe with every program replaced by path isolation, of one of
    `ISOLATION_FAMILIES`."""
    shots = {shot.name: shot for shot in recipe.shots}
    programs: dict[str, Program] = {}
    for photo in recipe.photos:
        for sign, name in photo.shots:
            shot = shots[name]
            if not (shot.white or shot.primal_black or shot.dual_black):
                isolation = Isolation(photo.wanted, sign > 0.0, family == "confocal")
                programs[shot.program] = isolation
    return replace(recipe, programs=programs)


def check_isolation(recipe: Recipe, *, slot_s: float, limit_s: float) -> None:
    """Refuse path isolation if an exposure would take longer than `limit_s`, or too much memory,
    before anything large is made; `slot_s` is the time of one pair. Raises RequestError."""
    for program in recipe.programs.values():
        if isinstance(program, Isolation):
            _check(program, slot_s, limit_s)


def _check(program: Isolation, slot_s: float, limit_s: float) -> None:
    count = program.count()
    if count * slot_s > limit_s:
        raise RequestError(
            f"path isolation of {count} pairs of cells takes {count * slot_s:.0f} s a photo; "
            f"the limit is {limit_s:g} s",
            hint="use codes, a coarser grid, or raise limits.max_exposure_s",
        )
    if count * program.wanted.cells > _MAX_LEVELS:
        raise RequestError(
            f"path isolation of {count} pairs of cells takes {count * slot_s:.0f} s a photo and "
            "more memory than is sensible",
            hint="use codes or a coarser grid",
        )


def _blocks(wanted: WantedMatrix) -> Iterator[tuple[int, Floats]]:
    for start in range(0, wanted.cells, _BLOCK):
        yield start, wanted.rows(start, min(start + _BLOCK, wanted.cells))
