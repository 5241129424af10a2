"""What a recipe's codes make of a scene, evaluated densely: levels out, products and sums in.

Nothing of `pdcd.probing`, of the frames or of the pictures is used: a photo is the sum over its
pairs of mask times what the scene makes of the light. It is divided by one number, the one by which
its matrix comes closest to the wanted one, by one for each row, or by that of
matched cells.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import read_pattern_levels
from pdcd.planning.pairs import make_pattern_pairs, resolve_family
from pdcd.planning.plan import PatternPair
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import MATRICES, Target, check_target
from pdcd.recipes.make import finish_recipe, make_draft_recipe
from pdcd.recipes.recipe import Extremes, Recipe, RecipePhoto
from pdcd.watch import Watch

Floats = NDArray[np.float64]


def target(
    grid: tuple[int, int], name: str, arrays: Mapping[str, Floats], **numbers: object
) -> Target:
    """A goal with its arrays, checked."""
    goal = msgspec.convert({"name": name, **numbers}, Goal)
    planes = {k: np.asarray(a, float).ravel() for k, a in arrays.items() if k not in MATRICES}
    matrices = {k: np.asarray(a, float) for k, a in arrays.items() if k in MATRICES}
    return check_target(Target(goal, grid, planes, matrices))


def matrix_of(wanted: Target, how: CaptureScheme, seed: int = 0) -> tuple[Recipe, Floats]:
    """The recipe, and the matrix (N, N) that its answer realises, whole windows."""
    draft = make_draft_recipe(wanted, how)
    how = msgspec.structs.replace(how, family=resolve_family(None, "hadamard", draft, how))
    recipe = finish_recipe(draft, how)
    lattice = Lattice(wanted.grid, "whole")
    p = wanted.goal.p
    shown = make_pattern_pairs(
        recipe, how, how.family or "hadamard", lattice, p=p, seed=seed, watch=Watch()
    )
    photos = {photo.name: _matrix(photo, recipe, shown) for photo in recipe.photos}
    assert not isinstance(recipe.answer, Extremes)
    return recipe, np.sum([c * photos[name] for c, name in recipe.answer], axis=0)


def _matrix(photo: RecipePhoto, recipe: Recipe, shown: Mapping[str, PatternPair]) -> Floats:
    cells = recipe.target.cells
    shots = {shot.name: shot for shot in recipe.shots}
    total = np.zeros((cells, cells))
    for sign, name in photo.shots:
        if shots[name].white:
            total += sign
            continue
        primal, dual = shown[shots[name].program]
        for k in range(len(primal)):
            total += sign * np.outer(
                read_pattern_levels(dual, k, cells), read_pattern_levels(primal, k, cells)
            )
    wanted = photo.wanted.rows(0, cells)
    if photo.row_weights:
        norm = np.maximum(np.sum(wanted**2, axis=1), 1e-300)
        return np.asarray(total / (np.sum(total * wanted, axis=1) / norm)[:, None])
    if photo.wanted.by_direct:  # the matched cells, whose weight is the largest of their row
        here = np.arange(cells), wanted.argmax(axis=1)
        return np.asarray(total * (wanted[here].sum() / total[here].sum()))
    return np.asarray(total * (np.sum(wanted**2) / np.sum(total * wanted)))


def error(matrix: Floats, wanted: Floats, transport: Floats) -> float:
    """RMS error of the photo, over the RMS of the true one."""
    off = ((matrix - wanted) * transport).sum(axis=1)
    return float(np.sqrt(np.mean(off**2) / np.mean((wanted * transport).sum(axis=1) ** 2)))
