"""Where windows mix what neighbouring cells are matched with.

A quarter window opens for the code of a projector cell that reaches beyond it, and is shared by
four cells of the mask. That is right where neighbours are matched with neighbours, as by a shift
or by the map of a surface. Where a warp tears, each of the four sees light of the others' partners.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pdcd.probing.wanted import Grid, Indices, Match
from pdcd.recipes.recipe import Photo
from pdcd.runs.record import ShotRecord

TOGETHER = 1
"""Cells by which the partners of neighbours may lie nearer or further apart than these."""


def torn_share(photos: Iterable[Photo], shots: Sequence[ShotRecord]) -> float:
    """Largest share of cells, of these photos, that share windows with others which are matched
    elsewhere; 0 where all their `shots` were shown through whole windows. Photos that keep other
    light, too, lose little."""
    windows = {shot.name: shot.window for shot in shots}
    share = 0.0
    for photo in photos:
        wanted = photo.wanted
        alone = all(isinstance(part, Match) for _, part in wanted.parts)
        parted = any(windows.get(name, "whole") != "whole" for _, name in photo.shots)
        if alone and parted and wanted.matched is not None:
            share = max(share, torn(wanted.matched, wanted.grid))
    return share


def torn(partner: Indices, grid: Grid) -> float:
    """Share of the cells with a partner, (N,), that touch one whose partner lies elsewhere."""
    rows, cols = grid
    there = (partner >= 0).reshape(grid)
    moved = np.array(np.divmod(partner.reshape(grid), cols)) - np.indices(grid)
    apart = np.zeros(grid, dtype=np.bool_)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = slice(0, rows - down), slice(max(0, -right), cols - max(0, right))
        next_ = slice(down, rows), slice(max(0, right), cols + min(0, right))
        differ = np.abs(moved[:, *here] - moved[:, *next_]).max(axis=0, initial=0) > TOGETHER
        differ &= there[here] & there[next_]
        apart[here] |= differ
        apart[next_] |= differ
    return float(np.count_nonzero(apart & there)) / max(int(there.sum()), 1)
