"""The error by direct light that gets through along the borders of whole cells.

Where the pixels of both panels do not meet they draw the border of a cell in two places, and
between these the light of one cell goes through the mask of the other (`pdcd.probing.borders`). How
much of the field that is, is known; which quads see it would take the camera's map to a tenth of a
quad. So it is an error of all quads that see two cells.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.combine import Picture, white_of
from pdcd.pictures.sigma import Barred, barred
from pdcd.recipes.recipe import Extremes, Recipe
from pdcd.sensor.cells import CellMap

Floats = NDArray[np.float64]

LEAST = 1e-4
"""Share of the field below which nobody could see it."""

UNEVEN = 1.7
"""Root of the mean square of such light over its mean, among quads that see a border: in places
both panels draw it alike."""


def with_border_light(
    pictures: Mapping[str, Barred],
    recipe: Recipe,
    photos: Mapping[str, Picture],
    apart: Mapping[str, float],
    cells: CellMap,
) -> dict[str, Barred]:
    """Pictures whose code error knows of such light, where they are made of a photo of indirect
    light, and a white one tells how much direct light there is.

    photos : scaled ones (`pdcd.pictures.combine.scaled_photos`). apart : of shots of whole cells,
    the share of the field in which both panels draw different cells.
    """
    white, found = white_of(recipe), dict(pictures)
    for photo in recipe.photos:
        share = min(apart.get(name, 0.0) for _, name in photo.shots)
        if photo.wanted.uniform != (0.0, 1.0) or not white or share < LEAST:
            continue
        direct = np.abs(photos[white[-1]].image - photos[photo.name].image)
        error = _of_quads(share, cells)[..., None] * direct
        for name, picture in found.items():
            rule = recipe.pictures[name]
            if isinstance(rule, Extremes):
                continue
            part = sum((abs(weight) for weight, one in rule if one == photo.name), 0.0)
            if part:
                code = np.hypot(picture.code, part * error).astype(picture.code.dtype)
                plain = Picture(picture.image, picture.sensor)
                found[name] = barred(plain, code, picture.kind)
    return found


def _of_quads(share: float, cells: CellMap) -> Floats:
    """What of the direct light gets into each quad, (h, w): the root of the mean square of those
    that see the border of a cell; where none does, as quads end with cells, the mean of all."""
    edges = cells.known & ~cells.single
    lines = float(np.count_nonzero(edges)) / max(int(np.count_nonzero(cells.known)), 1)
    if lines == 0.0:
        return np.full(cells.frame, share)
    return np.where(edges, min(UNEVEN * share / lines, 1.0), 0.0)
