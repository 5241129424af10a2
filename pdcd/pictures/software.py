"""Photos of single codes, masked and added up after the exposure instead of during it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.pictures.exposed import ComputedShot, ExposedShot
from pdcd.pictures.learn import code_times_s
from pdcd.pictures.to_quads import MixedCodes, expand_to_quads
from pdcd.pictures.weights import RealisedMatrix, RealisedShot
from pdcd.probing.realised import Factors
from pdcd.recipes.alternatives import FittedWeights, MaskedWeights
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap


def sum_stack_matrices(
    recipe: Recipe, shots: Mapping[str, RealisedShot], bits: Bools
) -> dict[str, RealisedMatrix]:
    """Realised probing matrix of every weighted sum of a recipe over its stack: the sum of the
    photos' own matrices, each row multiplied by the weight of its cell.

    Parameters
    ----------
    recipe : its `sums` name the weights, its `stack` the shots.
    shots : each of a single code.
    bits : (K, N) bool, lit cells of each photo.
    """
    taken = [shots[name] for name in recipe.stack]
    return {
        name: _matrix(taken, weights) for name, weights in _weights(recipe, taken, bits).items()
    }


def sum_stack_shots(
    recipe: Recipe, shots: Mapping[str, ExposedShot], bits: Bools, cells: CellMap
) -> dict[str, ExposedShot]:
    """Every weighted sum of a recipe over its stack, as if it had been exposed that way.

    The variance is exact, photos being independent. Cells without any weight are as unknown as
    saturated ones.
    """
    taken = [shots[name] for name in recipe.stack]
    mixed, equal = MixedCodes.of(bits, cells), _equal(taken, bits)
    return {
        name: _sum(taken, weights, mixed, recipe.sums[name], equal)
        for name, weights in _weights(recipe, taken, bits).items()
    }


def _weights(recipe: Recipe, taken: Sequence[RealisedShot], bits: Bools) -> dict[str, Floats]:
    """Weight of each cell of each photo, (K, N), by the name of the sum.

    Each photo is first scaled from its own time to the mean time of all. If each lasts one refresh,
    the times differ by a few per cent where projector and mask drift against each other.
    """
    equal = _equal(taken, bits)
    return {name: weigh(bits) * equal[:, None] for name, weigh in recipe.sums.items()}


def _equal(taken: Sequence[RealisedShot], bits: Bools) -> Floats:
    """Mean time of all photos over that of each, (K,)."""
    times = code_times_s([shot.realised for shot in taken], bits)
    return np.asarray(times.mean() / times)


def _matrix(taken: Sequence[RealisedShot], weights: Floats) -> RealisedMatrix:
    coaxial, open_s = np.zeros(weights.shape[1]), np.zeros(weights.shape[1])
    for weight, shot in zip(weights, taken, strict=True):
        coaxial += weight * shot.realised.coaxial
        open_s += weight * shot.realised.open_s
    left = [weight * shot.realised.left for weight, shot in zip(weights, taken, strict=True)]
    right = [shot.realised.right for shot in taken]
    realised = Factors(np.concatenate(left), np.concatenate(right), coaxial, open_s)
    return RealisedMatrix(realised, sum(shot.missed for shot in taken))


def _sum(
    taken: Sequence[ExposedShot],
    weights: Floats,
    mixed: MixedCodes,
    weigh: FittedWeights | MaskedWeights,
    equal: Floats,
) -> ExposedShot:
    """``sum_k w_k * photo_k``."""
    first = taken[0].variance
    light, variance = np.zeros(first.shape), np.zeros_like(first)
    saturated = expand_to_quads(np.logical_not(weights.any(axis=0)), mixed.cells, None)
    for photo, (weight, shot) in enumerate(zip(weights, taken, strict=True)):
        of_quads = mixed.weigh_quads(weight, photo, weigh, equal)
        saturated = saturated | (shot.saturated & (of_quads != 0.0))
        light += of_quads[..., None] * shot.light
        squared = (of_quads**2).astype(variance.dtype)
        variance += squared[..., None] * shot.variance
    shown = _matrix(taken, weights)
    return ComputedShot(
        light=light,
        variance=variance,
        saturated=saturated,
        realised=shown.realised,
        exif={},
        missed=shown.missed,
    )
