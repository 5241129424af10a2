"""The pictures of a run with their whole error: by what its parts show, or by the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pdcd.pictures.beside import beside_errors, pictures_beside
from pdcd.pictures.border_light import with_border_light
from pdcd.pictures.combine import Picture, pictures_of
from pdcd.pictures.exposed import Exposed
from pdcd.pictures.learn import Learned
from pdcd.pictures.parted import barred_by_parts, part_images
from pdcd.pictures.photos import corrected_photos
from pdcd.pictures.sigma import Barred
from pdcd.pictures.sigma_model import modelled
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

    def photos(part: Recipe, shots: Mapping[str, Exposed], cells: CellMap) -> dict[str, Picture]:
        return corrected_photos(
            part,
            shots,
            learned,
            cells,
            normalise=record.normalise,
            smooth=record.smooth,
            unmix=record.unmixed,
            alive=alive,
        )

    scaled = photos(recipe, shots, cells)
    whole, near = pictures_of(recipe, scaled), {}
    if record.alike:
        normalise = record.normalise
        near = beside_errors(recipe, shots, scaled, learned, cells, normalise=normalise)
    bars = record.how.bars
    if len(part_numbers(recipe)) < FEWEST_PARTS:
        sharp = learned.sharp if learned is not None and record.scouted else None
        barred = modelled(
            recipe, shots, scaled, whole, cells, alive, sharp,
            near=near, by_row=bars, shown=record.how.direct_bars,
        )  # fmt: skip
    else:
        by_cell = record.parts_by_cell
        told = by_cell and record.parts_apart
        parts = part_images(recipe, shots, cells, photos, by_cell=by_cell, apart=told)
        alike = pictures_beside(recipe, scaled, near)
        barred = barred_by_parts(whole, parts, cells, alike, by_chance=bars, apart=told)
    return with_border_light(barred, recipe, scaled, apart, cells) if record.alike else barred
