"""The photos of a recipe, scaled and corrected: the same for runs and for forecasts.

What codes get wrong of the paths that a pilot found, and of smooth light, is computed on cells and
expanded to the quads of the photo.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from pdcd.arrays import Bools, Floats
from pdcd.pictures.combine import NO_PICTURES, scale_photos
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.learn import PilotFindings, compute_path_corrections, compute_path_light
from pdcd.pictures.picture import Picture
from pdcd.pictures.smooth import CodedImage, compute_colour_correction, estimate_smooth_shares
from pdcd.pictures.to_cells import find_seen_cells
from pdcd.pictures.to_quads import add_missing_light, expand_to_quads
from pdcd.pictures.weights import CellWeights, weigh_cells
from pdcd.recipes.parts import FEWEST_PARTS, list_parts, select_parts
from pdcd.recipes.recipe import Recipe, RecipePhoto
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

if TYPE_CHECKING:
    from pdcd.pictures.border_light import BorderMeasurement


@dataclass(frozen=True, eq=False)
class SmoothModel:
    """Estimate of a photo's smooth light from its parts: the light of cells without known paths,
    (N, C), and the shares of each kind, (P,) (`pdcd.pictures.smooth.estimate_smooth_shares`).

    Each part is corrected by the light of all of them, as its own is much less certain.
    """

    light: Floats
    shares: Floats


NO_SMOOTH_MODELS: Mapping[str, SmoothModel] = MappingProxyType({})


def make_corrected_photos(
    recipe: Recipe,
    shots: Mapping[str, ExposedShot],
    learned: PilotFindings | None,
    cells: CellMap,
    *,
    normalise: NormaliseName,
    smooth: bool,
    alive: Callable[[], None] = lambda: None,
    told: Mapping[str, SmoothModel] = NO_SMOOTH_MODELS,
    borders: BorderMeasurement | None = None,
    room: Floats | None = None,
    whites: Mapping[str, Picture] = NO_PICTURES,
) -> dict[str, Picture]:
    """Every photo divided by its weight, coded ones corrected for what their codes get wrong.

    Parameters
    ----------
    normalise : as of `pdcd.pictures.weights.weigh_cells`.
    learned : paths that a pilot found, whose error in photos is known.
    smooth : correct the coded photo for its smooth light, too (`pdcd.pictures.smooth`), and photos
        of far light. A cell's missing light is shared out among its quads in proportion to light.
    alive : called now and then, and may raise to end the work.
    told : models estimated from the parts of photos, by name (`fit_smooth_models`). A photo without
        one is corrected by its own light, where any quad sees its cells.
    borders : what a photo of the light along borders of cells shows, if there is one.
    room : (N, C), what gets through an open mask in front of a black projector in a second, where a
        dark photo shows it and nothing else removes it.
    whites : photos of all light that this function made of the very same shots before.
    """
    weights = {photo.name: weigh_cells(photo, shots, normalise) for photo in recipe.photos}
    missing = {
        name: expand_to_quads(wrong, cells, weights[name].realised.fine)
        for name, wrong in _missing(recipe, weights, learned).items()
    }
    photos = scale_photos(recipe, weights, shots, cells, missing, borders, room, whites)
    for photo in recipe.photos:
        if not smooth or not _holds_smooth_light(photo):
            continue
        before, weighed = photos[photo.name], weights[photo.name]
        seen = find_seen_cells(cells)
        light = _with_unseen(cells.mean(before.image), seen)
        more = _missing_smooth(
            weighed, light, learned, cells.grid, seen, told.get(photo.name), alive
        )
        after = add_missing_light(before, light, more, cells, weighed.realised.fine)
        photos[photo.name] = after
        if "direct" in photos and not photo.beyond:
            # The other photo of the pair gets the opposite error from its codes.
            direct = photos["direct"]
            image = direct.image - (after.image - before.image)
            photos["direct"] = Picture(image, direct.sigma)
    return photos


def fit_smooth_models(
    recipe: Recipe,
    shots: Mapping[str, ExposedShot],
    learned: PilotFindings | None,
    cells: CellMap,
    *,
    seen: Bools | None = None,
    normalise: NormaliseName,
    alive: Callable[[], None] = lambda: None,
    room: Floats | None = None,
) -> Mapping[str, SmoothModel]:
    """Estimates from the parts of photos the smooth light that `make_corrected_photos` corrects
    them for.

    Arguments as there. Photos that are not split get no model, nor do any if there are fewer parts
    than error bars need. Shots may be means over cells (`pdcd.pictures.to_cells.average_shots`).
    seen : cells (N,) that any quad of the camera sees, None for all.
    """
    numbers = list_parts(recipe)
    if len(numbers) < FEWEST_PARTS:
        return NO_SMOOTH_MODELS
    recipes = [recipe, *(select_parts(recipe, {part}) for part in numbers)]
    pictures = [
        make_corrected_photos(
            one, shots, learned, cells, normalise=normalise, smooth=False, room=room
        )
        for one in recipes
    ]
    found = {}
    of_map = find_seen_cells(cells)
    for photo, *parts in zip(*(one.photos for one in recipes), strict=True):
        if len(parts[0].shots) == len(photo.shots) or not _holds_smooth_light(photo):
            continue
        weights = [weigh_cells(one, shots, normalise) for one in (photo, *parts)]
        light = [_with_unseen(cells.mean(made[photo.name].image), of_map) for made in pictures]
        told = _told_of(weights, light, learned, cells.grid, seen, alive)
        if told is not None:
            found[photo.name] = told
    return found


def _holds_smooth_light(photo: RecipePhoto) -> bool:
    """Whether a photo is of far light, or a coded photo of indirect light."""
    return bool(photo.beyond) or (photo.name == "coded" and photo.wanted.uniform == (0.0, 1.0))


def _missing(
    recipe: Recipe, weights: Mapping[str, CellWeights], learned: PilotFindings | None
) -> dict[str, Floats]:
    """Corrections of cells for the paths that a pilot found, (N, C) for each photo."""
    return {
        photo.name: compute_path_corrections(
            learned, weights[photo.name].realised, weights[photo.name].cells_s, photo.wanted
        )
        for photo in recipe.photos
        if photo.paths and learned is not None
    }


def _with_unseen(light: Floats, seen: Bools | None) -> Floats:
    """Light of cells (N, C) in which cells that no quad sees have the mean light of the others."""
    if seen is not None:
        light[~seen] = light[seen].mean(axis=0) if seen.any() else 0.0
    return light


def _without_paths(light: Floats, photo: RecipePhoto, learned: PilotFindings | None) -> Floats:
    """Light of cells (N, C) without that of known paths."""
    if learned is None or not photo.paths:
        return light
    return light - compute_path_light(learned, photo.wanted)


def _missing_smooth(
    weights: CellWeights,
    light: Floats,
    learned: PilotFindings | None,
    grid: tuple[int, int],
    seen: Bools | None,
    told: SmoothModel | None,
    alive: Callable[[], None],
) -> Floats:
    """What to add to the light of cells, (N, C), for their smooth light."""
    photo, realised = weights.photo, weights.realised
    rest, shares = _without_paths(light, photo, learned), None
    if told is not None:
        rest, shares = told.light, told.shares
    return compute_colour_correction(
        realised.left, realised.right, weights.cells_s, rest, grid, alive, photo.beyond, shares,
        seen,
    )  # fmt: skip


def _told_of(
    weights: Sequence[CellWeights],
    light: Sequence[Floats],
    learned: PilotFindings | None,
    grid: tuple[int, int],
    seen: Bools | None,
    alive: Callable[[], None],
) -> SmoothModel | None:
    """Estimate of a photo's smooth light from its parts; None for a dark photo.

    weights, light : of the photo and of each of its parts, in that order; (N, C) each.
    """
    rest = [
        _without_paths(one, weighed.photo, learned)
        for weighed, one in zip(weights, light, strict=True)
    ]
    coded = [
        CodedImage(one.realised.left, one.realised.right, one.cells_s, left.mean(axis=1))
        for one, left in zip(weights, rest, strict=True)
    ]
    shares = estimate_smooth_shares(coded[0], coded[1:], grid, weights[0].photo.beyond, alive, seen)
    return None if shares is None else SmoothModel(rest[0], shares)
