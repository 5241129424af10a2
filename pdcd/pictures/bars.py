"""The pictures of a run with their whole error: by what its parts show, or by the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pdcd.pictures.beside import beside_errors, pictures_beside
from pdcd.pictures.border_light import with_border_light
from pdcd.pictures.combine import Picture, pictures_of
from pdcd.pictures.exposed import Exposed
from pdcd.pictures.learn import Learned
from pdcd.pictures.parted import averaged, barred_by_parts, part_images, used
from pdcd.pictures.photos import NOTHING_TOLD, corrected_photos, told_by_parts
from pdcd.pictures.sigma import Barred
from pdcd.pictures.sigma_model import modelled
from pdcd.pictures.smoothed import seen_of
from pdcd.recipes.parts import FEWEST_PARTS, part_numbers
from pdcd.recipes.recipe import Recipe
from pdcd.runs.record import RunRecord
from pdcd.sensor.cells import CellMap


def barred_pictures(
    record: RunRecord,
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    learned: Learned | None,
    cells: CellMap,
    apart: Mapping[str, float],
    alive: Callable[[], None],
) -> dict[str, Barred]:
    """All pictures of a recipe with sensor and code error: of what the parts show, if there are
    enough; and with what all parts get wrong alike, as far as it is known.

    shots : of the run, and sums of them. learned : of its pilot, if any. apart : of shots of whole
    cells, the share of the field in which both panels draw different cells.
    """
    in_parts = len(part_numbers(recipe)) >= FEWEST_PARTS
    coarse, coarse_cells = shots, cells
    if in_parts:
        coarse, coarse_cells = averaged(used(recipe, shots), cells)
    told = NOTHING_TOLD
    if record.smooth:
        told = told_by_parts(
            recipe, coarse, learned, coarse_cells, seen=seen_of(cells),
            normalise=record.normalise, alive=alive,
        )  # fmt: skip

    def photos(part: Recipe, shots: Mapping[str, Exposed], cells: CellMap) -> dict[str, Picture]:
        return corrected_photos(
            part, shots, learned, cells, normalise=record.normalise, smooth=record.smooth,
            alive=alive, told=told,
        )  # fmt: skip

    scaled = photos(recipe, shots, cells)
    whole = pictures_of(recipe, scaled)
    near = beside_errors(recipe, shots, scaled, learned, cells, normalise=record.normalise)
    if in_parts:
        images = part_images(recipe, coarse, coarse_cells, photos, averaged_from=cells)
        barred = barred_by_parts(whole, images, cells, pictures_beside(recipe, scaled, near))
    else:
        sharp = None if learned is None else learned.sharp
        barred = modelled(recipe, shots, scaled, whole, cells, alive, sharp, near=near)
    return with_border_light(barred, recipe, scaled, apart, cells)
