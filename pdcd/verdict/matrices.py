"""What the matrices of photos tell by themselves: of torn windows, of light that was to be blocked
and got through, and of weights of direct light that are off.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from pdcd.arrays import Indices
from pdcd.pictures.weights import RealisedShot, is_divided_by_row, sum_realised_matrices
from pdcd.probing.convolved import SameRowPart
from pdcd.probing.deviation import weight_s
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import FullPart, Grid, MatchPart, MatrixPart, WantedMatrix
from pdcd.recipes.recipe import RecipePhoto
from pdcd.runs.record import ShotRecord
from pdcd.words import NormaliseName

_TOGETHER = 1
"""Cells by which the partners of neighbours may lie nearer or further apart than these."""


def warp_tear_share(photos: Iterable[RecipePhoto], shots: Sequence[ShotRecord]) -> float:
    """Largest share of cells, of these photos, that share windows with others which are matched
    elsewhere; 0 where all their `shots` were shown through whole windows. Photos that keep other
    light, too, lose little.

    A quarter window opens for the code of a projector cell that reaches beyond it, and is shared by
    four cells of the mask. That is right where neighbours are matched with neighbours, as by a
    shift or by the map of a surface. Where a warp tears, each of the four sees light of the others'
    partners.
    """
    windows = {shot.name: shot.window for shot in shots}
    share = 0.0
    for photo in photos:
        wanted = photo.wanted
        alone = all(isinstance(part, MatchPart) for _, part in wanted.parts)
        parted = any(windows.get(name, "whole") != "whole" for _, name in photo.shots)
        if alone and parted and wanted.matched is not None:
            share = max(share, count_torn_cells(wanted.matched, wanted.grid))
    return share


def count_torn_cells(partner: Indices, grid: Grid) -> float:
    """Share of the cells with a partner, (N,), that touch one whose partner lies elsewhere."""
    rows, cols = grid
    there = (partner >= 0).reshape(grid)
    moved = np.array(np.divmod(partner.reshape(grid), cols)) - np.indices(grid)
    apart = np.zeros(grid, dtype=np.bool_)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = slice(0, rows - down), slice(max(0, -right), cols - max(0, right))
        next_ = slice(down, rows), slice(max(0, right), cols + min(0, right))
        differ = np.abs(moved[:, *here] - moved[:, *next_]).max(axis=0, initial=0) > _TOGETHER
        differ &= there[here] & there[next_]
        apart[here] |= differ
        apart[next_] |= differ
    return float(np.count_nonzero(apart & there)) / max(int(there.sum()), 1)


def list_blocked_parts(wanted: WantedMatrix) -> list[MatrixPart]:
    """The paths that a photo is to block: of matched cells, or of rows. Direct light of an off-axis
    bench takes one of these, and nobody knows which."""
    return [p for w, p in wanted.parts if w < 0.0 and isinstance(p, MatchPart | SameRowPart)]


def compute_blocked_weight(realised: Factors, wanted: WantedMatrix, weight_s: float) -> float:
    """Mean weight in a photo of its `list_blocked_parts`, 0 where it has none.

    weight_s : of a path with a wanted weight of 1, in seconds.
    """
    own = np.arange(wanted.cells)
    got = paths = 0.0
    for part in list_blocked_parts(wanted):
        diagonal = part.entries(own)
        through = np.einsum("rn,rn->n", realised.left, part.others(realised.right))
        got += float(np.sum(through + diagonal * realised.coaxial))
        paths += float(np.sum(part.others(np.ones((1, wanted.cells))) + diagonal))
    return got / (paths * weight_s) if paths else 0.0


def compute_direct_weight_errors(
    photos: Sequence[RecipePhoto], panels: Mapping[str, RealisedShot], normalise: NormaliseName
) -> dict[str, float]:
    """Of photos that direct light alone scales, by one number for all cells, of those that keep a
    share of it beside other matched cells, and of an answer that is one photo of any weights: how
    far the weights of cells are off, over the wanted ones."""
    found = {}
    for photo in photos:
        wanted = photo.wanted.diagonal()
        power = float(np.mean(wanted**2))
        scaled = photo.wanted.by_direct and not photo.wanted.by_light
        alone = not photo.wanted.others(np.ones((1, wanted.size))).any()
        full = [w * part.matrix for w, part in photo.wanted.parts if isinstance(part, FullPart)]
        if full and len(photos) == 1:  # where hardly any direct light is wanted, what else is
            power, scaled = max(power, float(np.mean(full[0] ** 2))), power > 0.0
        elsewhere = photo.wanted.matched is not None
        # Cells whose partner lies beyond the field have no weight at all.
        counts = np.mean(wanted > 0.0) > 0.5 if elsewhere else scaled or alone
        if not counts or not power > 0.0:
            continue
        if is_divided_by_row(photo, panels, normalise):
            continue
        realised = sum_realised_matrices(photo.shots, panels)
        off = realised.coaxial / weight_s(realised, photo.wanted) - wanted
        found[photo.name] = float(np.sqrt(np.mean(off**2) / power))
    return found
