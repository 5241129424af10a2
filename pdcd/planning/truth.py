"""What a goal's image is on a scene whose transport is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pdcd.probing.wanted import Wanted
from pdcd.recipes.recipe import Extremes, Recipe
from pdcd.scene.scene import Scene

BLOCK = 256
"""Rows of the wanted matrix taken together; bounds the memory."""


def answer(
    scene: Scene, recipe: Recipe, alive: Callable[[], None] = lambda: None
) -> NDArray[np.float64]:
    """What a recipe's answer is in truth, (N, 3), in scene units, without ambient light.

    `alive` is called now and then, and may raise to end the work.
    """
    rule = recipe.answer
    if recipe.meant is not None:
        return probe(scene, recipe.meant, alive)
    if not isinstance(rule, Extremes):
        return probe(scene, recipe.wanted, alive)
    wanted = {photo.name: photo.wanted for photo in recipe.photos}
    images = np.stack([probe(scene, wanted[name], alive) for name in rule.photos])
    return np.asarray(rule.largest * images.max(axis=0) + rule.smallest * images.min(axis=0))


def probe(
    scene: Scene, wanted: Wanted, alive: Callable[[], None] = lambda: None
) -> NDArray[np.float64]:
    """``(Pi o T) 1`` with the wanted matrix itself, (N, 3), in scene units, without ambient light.

    Eq. 2 of the paper. Parts that are products cost one pass over the transport, and direct light
    none. Others are evaluated row by row, in O(N^2): a scene knows no single entries of T.
    """
    direct, indirect = scene.split()
    if wanted.uniform is not None:
        diagonal, off = wanted.uniform
        return diagonal * direct + off * indirect
    nothing = np.zeros(scene.cells)
    camera, projector = wanted.products()
    banded = wanted.banded()
    image = direct * banded.diagonal()[:, None]
    if len(camera):
        image += scene.photo(camera, projector, np.sum(camera * projector, axis=0), nothing)
    if not banded.squares().any():
        return image
    for start in range(0, scene.cells, BLOCK):
        alive()
        stop = min(start + BLOCK, scene.cells)
        rows = banded.rows(start, stop)
        pick = np.zeros((stop - start, scene.cells))
        here = np.arange(stop - start), np.arange(start, stop)
        pick[here], rows[here] = 1.0, 0.0
        image += scene.photo(pick, rows, nothing, nothing)
    return image


def entries(scene: Scene, seen: NDArray[np.int64], lit: NDArray[np.int64]) -> NDArray[np.float64]:
    """Entries of T between camera cells `seen` (C,) and projector cells `lit` (J,), (C, J, 3)."""
    found = np.empty((seen.size, lit.size, 3))
    for start in range(0, lit.size, BLOCK):
        some = lit[start : start + BLOCK]
        light = np.zeros((some.size, scene.cells))
        light[np.arange(some.size), some] = 1.0
        found[:, start : start + BLOCK] = scene.apply(light)[:, seen].transpose(1, 0, 2)
    return found
