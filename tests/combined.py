"""Pictures of a recipe by its shots alone: nothing is measured by parts, and nothing is learned."""

from __future__ import annotations

from collections.abc import Mapping

from pdcd.pictures.combine import scale_photos
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.picture import Picture, combine_photos
from pdcd.pictures.weights import weigh_cells
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName


def combine_shots(
    recipe: Recipe,
    shots: Mapping[str, ExposedShot],
    cells: CellMap,
    *,
    normalise: NormaliseName = "auto",
) -> dict[str, Picture]:
    """All pictures of a recipe, the answer first."""
    weights = {photo.name: weigh_cells(photo, shots, normalise) for photo in recipe.photos}
    return combine_photos(recipe, scale_photos(recipe, weights, shots, cells, {}))
