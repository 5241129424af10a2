"""Photos of single codes, masked and added up after the exposure instead of during it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.combine import Exposed
from pdcd.pictures.learn import time_s
from pdcd.probing.realised import Factors
from pdcd.recipes.recipe import Recipe

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def software_sums(recipe: Recipe, shots: Mapping[str, Exposed], bits: Bools) -> dict[str, Exposed]:
    """Every weighted sum of a recipe over its stack, as if it had been exposed that way.

    Parameters
    ----------
    recipe : its `sums` name the weights, its `stack` the shots.
    shots : developed photos, each of a single code.
    bits : (K, N) bool, lit cells of each photo.

    Each photo is first scaled from its own time to the mean time of all: with the time of one
    refresh each, they differ by a few per cent where projector and mask drift against each other.
    The realised probing matrix is the sum of the photos' own, each of its rows under the weight of
    the cell; the variance is exact, photos being independent.
    """
    taken = [shots[name] for name in recipe.stack]
    times_s = np.array([time_s(s.realised, lit) for s, lit in zip(taken, bits, strict=True)])
    equal = times_s.mean() / times_s
    return {
        name: _sum(recipe.goal.grid, taken, weigh(bits) * equal[:, None])
        for name, weigh in recipe.sums.items()
    }


def _sum(grid: tuple[int, int], taken: list[Exposed], weights: Floats) -> Exposed:
    """``sum_k w_k * photo_k``; cells without any weight are as unknown as saturated ones."""
    shape = taken[0].light.shape
    light, variance = np.zeros(shape), np.zeros(shape)
    saturated = _pixels(np.logical_not(weights.any(axis=0)), grid, shape)
    coaxial, open_s = np.zeros(weights.shape[1]), np.zeros(weights.shape[1])
    for weight, shot in zip(weights, taken, strict=True):
        of_pixels = _pixels(weight, grid, shape)[..., None]
        light += of_pixels * shot.light
        variance += of_pixels**2 * shot.variance
        saturated = saturated | (shot.saturated & (of_pixels[..., 0] != 0.0))
        coaxial += weight * shot.realised.coaxial
        open_s += weight * shot.realised.open_s
    left = [weight * shot.realised.left for weight, shot in zip(weights, taken, strict=True)]
    right = [shot.realised.right for shot in taken]
    return Exposed(
        light=light,
        variance=variance,
        saturated=saturated,
        realised=Factors(np.concatenate(left), np.concatenate(right), coaxial, open_s),
        exif={},
        missed=sum(shot.missed for shot in taken),
    )


def _pixels(cells: NDArray[Any], grid: tuple[int, int], shape: tuple[int, ...]) -> NDArray[Any]:
    """Values of cells (N,) -> of pixels (h, w)."""
    per_cell = (shape[0] // grid[0], shape[1] // grid[1])
    return cells.reshape(grid).repeat(per_cell[0], axis=0).repeat(per_cell[1], axis=1)
