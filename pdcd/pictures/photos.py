"""The photos of a recipe, scaled and corrected: one way for runs as they are and as foreseen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from pdcd.pictures.combine import Floats, Picture, realised_photo, scaled_photos
from pdcd.pictures.exposed import Exposed
from pdcd.pictures.learn import Learned, corrections
from pdcd.pictures.shares import Bools
from pdcd.pictures.smoothed import Told, smoothed, told_of
from pdcd.pictures.weights import brought, cell_weights_s, divided_by_row
from pdcd.recipes.parts import FEWEST_PARTS, only_parts, part_numbers
from pdcd.recipes.recipe import Photo, Recipe
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

NOTHING_TOLD: Mapping[str, Told] = MappingProxyType({})


def corrected_photos(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    learned: Learned | None,
    cells: CellMap,
    *,
    normalise: NormaliseName,
    smooth: bool,
    alive: Callable[[], None] = lambda: None,
    told: Mapping[str, Told] = NOTHING_TOLD,
) -> dict[str, Picture]:
    """Every photo divided by its weight, coded ones corrected for what their codes get wrong.

    Parameters
    ----------
    recipe, shots, normalise : as of `pdcd.pictures.combine.scaled_photos`.
    learned : paths that a pilot found, whose error in photos is known.
    smooth : correct the coded photo for its smooth light, too (`pdcd.pictures.smooth`), and photos
        of far light.
    alive : called now and then, and may raise to end the work.
    told : by the parts of photos, by their names (`told_by_parts`); others tell by themselves.
    """
    missing = _missing(recipe, shots, learned, cells, normalise)
    photos = scaled_photos(recipe, shots, cells, missing, normalise=normalise)
    for photo in recipe.photos:
        if not smooth or not _holds_smooth_light(photo):
            continue
        before = photos[photo.name]
        after = smoothed(
            photo, shots, before, learned if photo.paths else None, cells,
            normalise=normalise, alive=alive, told=told.get(photo.name),
        )  # fmt: skip
        photos[photo.name] = after
        if "direct" in photos and not photo.beyond:
            # Of a pair: its codes err by as much the other way.
            direct = photos["direct"]
            image = direct.image - (after.image - before.image)
            photos["direct"] = Picture(image, direct.sigma)
    return photos


def told_by_parts(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    learned: Learned | None,
    cells: CellMap,
    *,
    seen: Bools | None = None,
    normalise: NormaliseName,
    alive: Callable[[], None] = lambda: None,
) -> Mapping[str, Told]:
    """What the parts of photos tell of the smooth light that `corrected_photos` corrects them for.

    Arguments as there; nothing is told of photos that are not split, nor by fewer parts than
    measure the error bars. Means of cells do (`pdcd.pictures.parted.averaged`). seen : cells (N,)
    that any quad of the camera sees, None for all.
    """
    numbers = part_numbers(recipe)
    if len(numbers) < FEWEST_PARTS:
        return NOTHING_TOLD
    recipes = [recipe, *(only_parts(recipe, {part}) for part in numbers)]
    pictures = [
        corrected_photos(one, shots, learned, cells, normalise=normalise, smooth=False)
        for one in recipes
    ]
    found = {}
    for photo, *parts in zip(*(one.photos for one in recipes), strict=True):
        if len(parts[0].shots) == len(photo.shots) or not _holds_smooth_light(photo):
            continue
        told = told_of(
            photo, parts, shots, [made[photo.name] for made in pictures],
            learned if photo.paths else None, cells, seen=seen, normalise=normalise, alive=alive,
        )  # fmt: skip
        if told is not None:
            found[photo.name] = told
    return found


def _holds_smooth_light(photo: Photo) -> bool:
    """Whether a photo is of indirect light, or of far light, by codes."""
    return bool(photo.beyond) or (photo.name == "coded" and photo.wanted.uniform == (0.0, 1.0))


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
