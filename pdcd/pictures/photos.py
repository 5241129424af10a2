"""The photos of a recipe, scaled and corrected: one way for runs as they are and as foreseen."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pdcd.pictures.combine import Floats, Picture, realised_photo, scaled_photos
from pdcd.pictures.exposed import Exposed
from pdcd.pictures.learn import Learned, corrections
from pdcd.pictures.smoothed import smoothed
from pdcd.pictures.weights import brought, cell_weights_s, divided_by_row
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName


def corrected_photos(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    learned: Learned | None,
    cells: CellMap,
    *,
    normalise: NormaliseName,
    smooth: bool,
    unmix: bool = True,
    alive: Callable[[], None] = lambda: None,
) -> dict[str, Picture]:
    """Every photo divided by its weight, coded ones corrected for what their codes get wrong.

    Parameters
    ----------
    recipe, shots, normalise, unmix : as of `pdcd.pictures.combine.scaled_photos`.
    learned : paths that a pilot found, whose error in photos is known.
    smooth : correct the coded photo for its smooth light, too (`pdcd.pictures.smooth`), and photos
        of far light.
    alive : called now and then, and may raise to end the work.
    """
    missing = _missing(recipe, shots, learned, cells, normalise)
    photos = scaled_photos(recipe, shots, cells, missing, normalise=normalise, unmix=unmix)
    for photo in recipe.photos:
        indirect = photo.name == "coded" and photo.wanted.uniform == (0.0, 1.0)
        if not smooth or not (indirect or photo.beyond):
            continue
        before = photos[photo.name]
        known = learned if photo.paths else None
        after = smoothed(photo, shots, before, known, cells, normalise=normalise, alive=alive)
        photos[photo.name] = after
        if indirect and "direct" in photos:  # of a pair: its codes err by as much the other way
            direct = photos["direct"]
            image = direct.image - (after.image - before.image)
            photos["direct"] = Picture(image, direct.sigma)
    return photos


def _missing(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    learned: Learned | None,
    cells: CellMap,
    normalise: NormaliseName,
) -> dict[str, Floats]:
    """What photos get wrong of the paths that a pilot found, (h, w, 3) each."""
    missing: dict[str, Floats] = {}
    if learned is None:
        return missing
    for photo in recipe.photos:
        if photo.paths:
            realised = realised_photo(photo.shots, shots)
            by_row = divided_by_row(photo, shots, normalise)
            weight = cell_weights_s(photo, realised, by_row=by_row)
            wrong = corrections(learned, realised, weight, photo.wanted)
            missing[photo.name] = brought(wrong, cells, realised.fine)
    return missing
