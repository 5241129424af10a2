"""The error of a photo that cannot tell light from right beside a cell from direct light.

Under quarter windows the projector's code cell reaches a quarter of a cell beyond the window that
it belongs to. So a photo of indirect light lacks some of what comes from the cells around, and has
some of what wandered within its own. All parts of a photo do so alike: their spread does not show
it. How much light there is of either kind is modelled: of the pilot's photos what they tell
(`pdcd.codes.pilot.scene_light`), else a share of all light.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.combine import (
    Picture,
    divided_by_row,
    realised_photo,
    sigma_of,
)
from pdcd.pictures.exposed import Exposed
from pdcd.pictures.learn import Learned
from pdcd.pictures.smooth import beside
from pdcd.pictures.weights import cell_weights_s
from pdcd.recipes.recipe import Extremes, Photo, Recipe
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

Floats = NDArray[np.float64]

USUAL = 0.02
"""Light from one of the eight cells around, over all indirect light, where no pilot tells: between
the virtual scenes with little of it (0.1 to 1 %) and those with much (2 to 7 %)."""
UNEVEN = 1.3
"""Root of the mean square of what the eight send, over its mean: 1.05 to 2.5 before the virtual
scenes."""
LEAST = 0.15
"""Weight that is off, in paths of one cell, below which it is the chance of codes: a photo of whole
cells has none but that."""


def beside_errors(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    photos: Mapping[str, Picture],
    learned: Learned | None,
    cells: CellMap,
    *,
    normalise: NormaliseName = "auto",
) -> dict[str, Floats]:
    """Standard deviation, (rows, cols, 3), of the means over cells of all photos that have such an
    error.

    photos : scaled ones (`pdcd.pictures.combine.scaled_photos`). learned : of a pilot, if any.
    """
    found = {}
    for photo in recipe.photos:
        weight = _off(photo, shots, cells.grid, normalise)
        if weight < LEAST:
            continue
        if learned is not None and learned.near.any():
            near = learned.near
        else:
            near = USUAL * np.maximum(cells.mean(photos[photo.name].image), 0.0)
        found[photo.name] = UNEVEN * weight * near.reshape(*cells.grid, -1)
    return found


def pictures_beside(
    recipe: Recipe, photos: Mapping[str, Picture], near: Mapping[str, Floats]
) -> dict[str, Floats]:
    """The same of the pictures that are made of those photos, by name."""
    if not near:
        return {}
    none = np.zeros_like(next(iter(near.values())))
    alone = {name: near.get(name, none) for name in photos}
    return {
        name: np.asarray(sigma_of(rule, photos, alone))
        for name, rule in recipe.pictures.items()
        if not isinstance(rule, Extremes)
    }


def _off(
    photo: Photo, shots: Mapping[str, Exposed], grid: tuple[int, int], normalise: NormaliseName
) -> float:
    """How much light from one of the cells around is worth in the error of a photo: what is lacking
    of all eight, and what is there of the cell's own, whose size nobody knows. 0 of photos that do
    not want all other cells alike."""
    if photo.wanted.uniform is None or photo.wanted.uniform[0] == photo.wanted.uniform[1]:
        return 0.0
    diagonal, off = photo.wanted.uniform
    realised = realised_photo(photo.shots, shots)
    weight_s = cell_weights_s(photo, realised, by_row=divided_by_row(photo, shots, normalise))
    lacking = sum(
        off - share for share in beside(realised.left, realised.right, weight_s, grid).values()
    )
    own = float(np.mean(realised.row_sums_s[1] / weight_s)) - diagonal
    return float(np.hypot(lacking, own))
