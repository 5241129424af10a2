"""Light that panels let through before they have switched: how far it is off, as the differences
between the parts of a photo show.

How much of this direct light there is differs from part to part with the order of the codes, and is
computed from the times that panels are believed to keep. The scene is the same in all parts, and
the chance of codes follows another order. So the differences between parts tell how well that
computation fits, however little is known of the scene.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.pictures.picture import sum_weighted
from pdcd.pictures.to_cells import AveragedShots
from pdcd.pictures.weights import sum_realised_matrices
from pdcd.probing.deviation import weight_s
from pdcd.probing.realised import Factors
from pdcd.recipes.parts import FEWEST_PARTS, list_parts, select_parts
from pdcd.recipes.recipe import Recipe, RecipePhoto

UNSURE_SLOW_LIGHT = 0.5
"""Relative error where parts do not tell it, and the largest that chance can make of what they
tell: 0.3 of 0.6 % in front of a stranger's fold, where rows are set last."""
_SURE = 4.0
"""Standard deviations from which light is surely off."""
_LEAST_APART = 1e-3
"""Least differences between parts, over the light itself, from which they tell anything."""
_FEWEST_PATCHES = 6.0
"""Least number of patches among which the light is spread for their differences to tell an error.
"""
_PATCH_CELLS = 4
"""Side, in cells, of the patches of the field whose errors are taken as independent: the light of
neighbouring cells is correlated."""


@dataclass(frozen=True)
class _Sums:
    """Signed sums over the shots of a photo: its matrix; its grey light without that of the room,
    and for how long cells were seen in their own light because panels are slow, (N,) each."""

    realised: Factors
    light: Floats
    slow: Floats

    @classmethod
    def of(
        cls,
        photo: RecipePhoto,
        averaged: AveragedShots,
        slow: Mapping[str, Floats],
        room: Floats | None,
    ) -> _Sums:
        """room : (N, C), light of the room on cells in a second, where a dark photo shows it."""
        shots, grid = averaged.shots, averaged.cells.grid
        realised = sum_realised_matrices(photo.shots, shots)
        light = sum_weighted(
            (sign, _to_grey_cells(shots[name].light, grid)) for sign, name in photo.shots
        )
        if room is not None:
            light = light - realised.open_s * room.mean(axis=1)
        none = np.zeros_like(light)
        late = sum_weighted((sign, slow.get(name, none)) for sign, name in photo.shots)
        return cls(realised, light, late)


def estimate_slow_light_errors(
    recipe: Recipe,
    averaged: AveragedShots,
    slow: Mapping[str, Floats],
    room: Floats | None = None,
) -> dict[str, float]:
    """Relative error of the direct light that is subtracted from photos of indirect light: by
    photo, for error bars. Left out are photos whose parts cannot tell.

    Parts tell of the light that slow panels let through. Other light that gets past the codes,
    through black or wrong cells, is much the same in all parts, and as unsure as without them.
    Windows of parts of cells also let near light through by the order of codes: they tell nothing.

    averaged : the shots over cells. slow : `pdcd.pictures.weights.RealisedMatrix.slow` of shots of
    codes. room : (N, C), light of the room on cells in a second, from a dark photo.
    """
    white = [photo for photo in recipe.photos if photo.wanted.uniform == (1.0, 1.0)]
    if not white:
        return {}
    full = _Sums.of(white[-1], averaged, {}, room)
    coaxial = full.realised.coaxial
    known = (coaxial > 0.0) & _find_known_cells(averaged)
    if not known.any():
        return {}
    all_light = np.divide(full.light, coaxial, out=np.zeros(known.shape), where=known)
    found = {}
    for number, photo in enumerate(recipe.photos):
        if photo.wanted.uniform != (0.0, 1.0):
            continue
        parts = [select_parts(recipe, {part}).photos[number] for part in list_parts(recipe)]
        sums = [_Sums.of(part, averaged, slow, room) for part in parts if part.shots]
        weights_s = [weight_s(one.realised, photo.wanted) for one in sums]
        lit = [pair for pair in zip(sums, weights_s, strict=True) if pair[1] > 0.0]
        error = _estimate_error(lit, all_light, known, number_patches(averaged.cells.grid))
        if error is not None:
            found[photo.name] = error
    return found


def _estimate_error(
    parts: Sequence[tuple[_Sums, float]],
    all_light: Floats,
    known: Bools,
    patch: NDArray[np.intp],
) -> float | None:
    """The error in one photo. parts : each with its weight in seconds. all_light : (N,), of cells
    that are `known` (N,)."""
    cut = any(part.realised.fine is not None for part, _ in parts)
    if len(parts) < FEWEST_PARTS or cut:
        return None
    light, coaxial, slow = (
        np.stack([values[known] / weight for values, weight in each])
        for each in (
            [(part.light, weight) for part, weight in parts],
            [(part.realised.coaxial, weight) for part, weight in parts],
            [(part.slow, weight) for part, weight in parts],
        )
    )
    subtracted, switching = float(coaxial.mean()), float(slow.mean())
    if not 0.0 < switching or not 0.0 < subtracted < 1.0:
        return None
    direct = (all_light[known] - light.mean(axis=0)) / (1.0 - coaxial.mean(axis=0))
    found = _fit_slow_light(light - coaxial * direct, slow * direct, patch[known])
    if found is None:
        return None
    told = min(switching / subtracted, 1.0)
    return math.hypot(told * found, (1.0 - told) * UNSURE_SLOW_LIGHT)


def _fit_slow_light(light: Floats, slow: Floats, patch: NDArray[np.intp]) -> float | None:
    """By how much of itself the light of slow panels is off: of P parts (P, N), what is left of
    their light, and the light that slow panels let through."""
    apart = slow - slow.mean(axis=0)
    power = np.bincount(patch, np.sum(apart**2, axis=0))
    if not power.sum() > _LEAST_APART**2 * np.sum(slow**2):
        return None
    patches = float(power.sum() ** 2 / np.sum(power**2))
    if patches < _FEWEST_PATCHES:
        return None
    (off,), ((variance,),) = fit_part_differences(light, [slow], patch)
    # It may be off in some places alone, as in the rows that panels set last. The error of the mean
    # over all patches grows with their differences.
    sigma = math.sqrt(variance * patches / (patches - 1.0))
    error = min(math.hypot(off, math.sqrt(patches) * sigma), UNSURE_SLOW_LIGHT)
    return max(error, abs(float(off))) if abs(off) > _SURE * sigma else error


def _find_known_cells(averaged: AveragedShots) -> Bools:
    """Cells that the camera sees all over, and unsaturated in all shots, (N,)."""
    seen = np.ones(averaged.cells.frame)
    seen.reshape(-1)[averaged.unknown] = 0.0
    return np.asarray(_to_grey_cells(seen[..., None], averaged.cells.grid) == 1.0)


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
    """Least-squares factors of K patterns in the differences between P parts, and their covariance
    (K, K), from how much each patch of the field would change them. light, and each of `more`:
    (P, N). 0 for a pattern that is the same in all parts."""
    apart = light - light.mean(axis=0)
    by = np.stack([one - one.mean(axis=0) for one in more])
    inverse = np.linalg.pinv(np.einsum("ipn,jpn->ij", by, by))
    times = inverse @ np.einsum("ipn,pn->i", by, apart)
    pulls = np.sum(by * (apart - np.tensordot(times, by, 1)), axis=1)
    spread = inverse @ np.stack([np.bincount(patch, one) for one in pulls])
    return times, np.asarray(spread @ spread.T)
