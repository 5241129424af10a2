"""What the parts of a coded photo show, each by itself: the means of its cells.

Nothing finer is asked of a part, as its error is wanted cell by cell. So the shots are averaged
over cells first, once each, and all parts are worked out on these few values. A part then has the
weight of a cell where the photo has that of each quad; it is the same in all parts, whose
differences alone are looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from pdcd.pictures.combine import Floats, Picture, pictures_of
from pdcd.pictures.exposed import Exposed, Print
from pdcd.pictures.quads import image_of_cells, means
from pdcd.recipes.parts import only_parts, part_numbers
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap

Photos = Callable[[Recipe, Mapping[str, Exposed], CellMap], dict[str, Picture]]
"""Scales and corrects the photos of a recipe."""


def part_images(
    recipe: Recipe, shots: Mapping[str, Exposed], cells: CellMap, photos: Photos, *, by_cell: bool
) -> dict[str, list[Floats]]:
    """Every picture as each part alone makes it, (rows, cols, 3) in scene units.

    by_cell : average the shots first. Without it every part is worked out on all quads, as in runs
        from before that was done.
    """
    unseen = np.zeros(0, np.int64)
    if by_cell:
        unseen = np.flatnonzero(~cells.seen())
        shots, cells = averaged(_used(recipe, shots), cells)
    found: dict[str, list[Floats]] = {name: [] for name in recipe.pictures}
    for number in part_numbers(recipe):
        part = only_parts(recipe, {number})
        for name, picture in pictures_of(part, photos(part, shots, cells)).items():
            image = image_of_cells(picture, cells)
            image.reshape(-1, image.shape[2])[unseen] = 0.0
            found[name].append(image)
    return found


def averaged(shots: Mapping[str, Exposed], cells: CellMap) -> tuple[dict[str, Exposed], CellMap]:
    """Shots as a camera with one quad a cell would have taken them, and the map of that camera.

    Quads that are saturated in any shot do not count, but where too little of a cell is left all
    of it does. Cells that no quad sees are as bright as the mean of the others. There is no
    variance: it is not asked for.
    """
    alike = CellMap.block(cells.grid, cells.grid)
    lost = np.logical_or.reduce([shot.saturated for shot in shots.values()])
    known = ~lost if lost.any() else None
    unseen = ~cells.seen()
    shape = *cells.grid, 3
    nothing, dark = np.zeros(shape), np.zeros(cells.grid, np.bool_)

    def coarse(shot: Exposed) -> Print:
        light, _ = means(_whole(shot.light, cells), known, cells)
        if unseen.any() and not unseen.all():
            light[unseen] = light[~unseen].mean(axis=0)
        return Print(light.reshape(shape), nothing, dark, shot.realised, shot.exif, shot.missed)

    return {name: coarse(shot) for name, shot in shots.items()}, alike


def _whole(light: Floats, cells: CellMap) -> Floats:
    """Light of quads that see past the border of the field, as if they did not."""
    if cells.inside is None:
        return light
    share = np.where(cells.known & (cells.inside > 0.0), cells.inside, 1.0)
    return np.asarray(light / share[..., None])


def _used(recipe: Recipe, shots: Mapping[str, Exposed]) -> dict[str, Exposed]:
    """The shots of a recipe's photos."""
    names = dict.fromkeys(name for photo in recipe.photos for _, name in photo.shots)
    return {name: shots[name] for name in names}
