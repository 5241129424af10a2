"""Light that panels let through before they have switched: how far it is off, as the differences
between the parts of a photo show.

How much of this direct light there is differs from part to part with the order of the codes, and is
computed from the times that panels are believed to keep. The scene is the same in all parts, and
the chance of codes follows another order. So the differences between parts tell how well that
computation fits, however little is known of the scene.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.pictures.picture import sum_weighted
from pdcd.pictures.to_cells import AveragedShots
from pdcd.probing.deviation import weight_s
from pdcd.recipes.parts import FEWEST_PARTS
from pdcd.recipes.recipe import Recipe, RecipePhoto
from pdcd.runs.record import RunRecord

UNSURE_SLOW_LIGHT = 0.5
"""Relative error where parts do not tell it, and the largest that chance can make of what they
tell: 0.3 of 0.6 % in front of a stranger's fold, where rows are set last."""
_SURE = 4.0
"""Standard deviations from which light is surely off."""
_PATCH_CELLS = 4
"""Side, in cells, of the patches of the field whose errors are taken as independent: the light of
neighbouring cells is correlated."""


def estimate_slow_light_errors(
    record: RunRecord, recipe: Recipe, averaged: AveragedShots
) -> dict[str, float]:
    """Relative error of the light that slow panels let through, which is subtracted from photos of
    indirect light: by photo, for its error bars. Left out are photos whose parts cannot tell.

    Light that a black panel lets through for good is the same in all parts, which then say nothing
    of it: that part of the light counts as unsure as without parts.

    averaged : the shots over cells.
    """
    white = [photo for photo in recipe.photos if photo.wanted.uniform == (1.0, 1.0)]
    if not white:
        return {}
    full, taken = _sum_shots(white[-1], averaged)
    known = (full > 0.0) & _find_seen_cells(averaged)
    all_light = np.divide(taken, full, out=np.full(full.shape, np.nan), where=known)
    found = {}
    for photo in recipe.photos:
        if photo.wanted.uniform == (0.0, 1.0):
            error = _estimate_error(photo, averaged, all_light, _compute_black_share(record))
            if error is not None:
                found[photo.name] = error
    return found


def _estimate_error(
    photo: RecipePhoto, averaged: AveragedShots, all_light: Floats, black: float
) -> float | None:
    """The error in one photo. all_light : (N,), NaN where it is not known. black : share of the
    direct light that gets through black panels."""
    shots, grid = averaged.shots, averaged.cells.grid
    lit = {
        name: weight
        for sign, name in photo.shots
        if sign > 0.0 and (weight := weight_s(shots[name].realised, photo.wanted)) > 0.0
    }
    if len(lit) < FEWEST_PARTS:
        return None
    light, believed = (
        np.stack([one / weight for one, weight in zip(each, lit.values(), strict=True)])
        for each in (
            [_to_grey_cells(shots[name].light, grid) for name in lit],
            [shots[name].realised.coaxial for name in lit],
        )
    )
    direct = np.nan_to_num((all_light - light.mean(axis=0)) / (1.0 - believed.mean(axis=0)))
    patch = number_patches(grid)
    off, sigma = fit_part_differences(light - believed * direct, [believed * direct], patch)
    # It may be off in some places alone, as in the rows that panels set last. The error of the mean
    # over all patches grows with their differences.
    error = min(float(np.hypot(off[0], sigma[0] * np.sqrt(patch.max() + 1.0))), UNSURE_SLOW_LIGHT)
    if abs(off[0]) > _SURE * sigma[0]:
        error = max(error, abs(float(off[0])))
    subtracted = float(_sum_shots(photo, averaged)[0].mean()) / sum(lit.values())
    # Black exposures, if there are any, take part of the light through black panels away.
    black = max(black - max(float(believed.mean()) - subtracted, 0.0), 0.0)
    untold = black / max(subtracted, black) if black else 0.0
    return math.hypot((1.0 - untold) * error, untold * UNSURE_SLOW_LIGHT)


def _sum_shots(photo: RecipePhoto, averaged: AveragedShots) -> tuple[Floats, Floats]:
    """For how long cells were seen in their own light in a photo, in seconds, and their light in
    it, (N,) each."""
    coaxial, light = (
        sum_weighted((sign, of_shot(averaged.shots[name])) for sign, name in photo.shots)
        for of_shot in (
            lambda shot: shot.realised.coaxial,
            lambda shot: _to_grey_cells(shot.light, averaged.cells.grid),
        )
    )
    return coaxial, light


def _find_seen_cells(averaged: AveragedShots) -> Bools:
    """Cells that the camera sees all over, (N,)."""
    seen = np.ones(averaged.cells.frame)
    seen.reshape(-1)[averaged.unseen] = 0.0
    return np.asarray(_to_grey_cells(seen[..., None], averaged.cells.grid) == 1.0)


def _compute_black_share(record: RunRecord) -> float:
    """Share of the direct light that gets through where either panel is black, as far as this is
    not taken out with the light of the room: by codes of as much black as white."""
    panels = [record.mask, *([] if record.room is not None else [record.projector])]
    return sum(1.0 / panel.contrast for panel in panels if panel.contrast)


def _to_grey_cells(light: Floats, grid: tuple[int, int]) -> Floats:
    """Grey means over cells, (N,), of pixels that fill each cell evenly, (h, w, C)."""
    (rows, cols), grey = grid, light.mean(axis=-1)
    side = grey.shape[0] // rows
    return np.asarray(grey.reshape(rows, side, cols, side).mean(axis=(1, 3)).ravel())


def number_patches(grid: tuple[int, int]) -> NDArray[np.intp]:
    """Number of the patch of the field that each cell lies in, (N,)."""
    down, right = (at.ravel() // _PATCH_CELLS for at in np.indices(grid))
    return np.asarray(down * (right.max() + 1) + right)


def fit_part_differences(
    light: Floats, more: Sequence[Floats], patch: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Least-squares factors of some patterns in the differences between parts, and their standard
    deviations; all are (P, N). 0 for a pattern that is the same in all parts."""
    apart = light - light.mean(axis=0)
    by = np.stack([one - one.mean(axis=0) for one in more])
    inverse = np.linalg.pinv(np.einsum("ipn,jpn->ij", by, by))
    times = inverse @ np.einsum("ipn,pn->i", by, apart)
    pulls = np.sum(by * (apart - np.tensordot(times, by, 1)), axis=1)
    spread = inverse @ np.stack([np.bincount(patch, one) for one in pulls])
    return times, np.linalg.norm(spread, axis=1)
