"""Shots -> photos and pictures with the error of their sensor, in the scene's own units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.picture import Picture, sum_weighted
from pdcd.pictures.to_quads import (
    QuadWeights,
    add_missing_light,
    compute_direct_share,
    find_quads_outside,
    weigh_quads,
)
from pdcd.pictures.weights import CellWeights, RealisedShot, weigh_cells
from pdcd.probing.realised import Factors
from pdcd.recipes.recipe import Recipe, RecipePhoto
from pdcd.sensor.bands import make_planar_image, run_in_bands
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

if TYPE_CHECKING:
    from pdcd.pictures.border_light import BorderLight, BorderMeasurement

FEWEST_TELLING_PARTS = 3
"""Least number of parts that tell of light by how they differ."""
NO_PICTURES: Mapping[str, Picture] = MappingProxyType({})
_LEAST_OPEN = 1e-6
"""Time of an open mask over a photo's weight that counts as none: black exposures are as long as
others, except for rounding."""


def scale_photos(
    recipe: Recipe,
    weights: Mapping[str, CellWeights],
    shots: Mapping[str, ExposedShot],
    cells: CellMap,
    added: Mapping[str, Floats],
    borders: BorderMeasurement | None = None,
    room: Floats | None = None,
    whites: Mapping[str, Picture] = NO_PICTURES,
) -> dict[str, Picture]:
    """Every photo of a recipe divided by its weight.

    Each photo is divided by its own least-squares weight before photos are subtracted (erratum
    X9). Shots are independent, so variances add with the squares of their factors. Each quad's
    weight is that of the windows that it saw (`pdcd.pictures.to_quads.weigh_quads`). Direct light
    that is known to be in a photo of indirect light is taken out (`remove_direct_light`), where
    there is a white photo. Raises DecodeError when a photo gathered no light at all.

    Parameters
    ----------
    weights : of the cells of each photo, by name (`pdcd.pictures.weights.weigh_cells`).
    cells : tells which quads see which cell.
    added : what is known to be missing from a photo, (h, w, C) in scene units, by name.
    borders : what a photo of the light along borders of cells shows, if there is one.
    room : (N, C), light of the room on cells in a second, from a dark photo.
    whites : photos of all light that were scaled before, by name.
    """
    scaled: dict[str, Picture] = {}
    direct: dict[str, Floats] = {}
    strips: dict[str, BorderLight] = {}
    white = list_white_photos(recipe)
    outside = find_quads_outside(cells)
    for photo in recipe.photos:
        if photo.name in whites:
            scaled[photo.name] = whites[photo.name]
            continue
        of_quads = _weigh_quads(weights[photo.name], cells)
        taken = [(sign, shots[name]) for sign, name in photo.shots]
        scaled[photo.name] = _scaled(taken, of_quads, added.get(photo.name), outside)
        if room is not None:
            scaled[photo.name] = _without_room(scaled[photo.name], weights[photo.name], room, cells)
        if _unmixes(photo, white):
            realised = weights[photo.name].realised
            border = _border_of(realised, of_quads, cells)
            if border is not None:
                strips[photo.name] = border
                if borders is not None:  # what blur and misplaced panels let through was seen
                    realised = replace(realised, coaxial=np.sum(realised.left * realised.right, 0))
            share = compute_direct_share(realised, of_quads, cells)
            if share is not None:
                direct[photo.name] = share
    for name, share in direct.items():
        scaled[name] = remove_direct_light(scaled[name], scaled[white[-1]], share)
    for name, border in strips.items():
        scaled[name] = border.take_out(scaled[name], scaled[white[-1]], borders)
    return scaled


def compute_removed_share(
    photo: RecipePhoto,
    recipe: Recipe,
    shots: Mapping[str, RealisedShot],
    cells: CellMap,
    *,
    normalise: NormaliseName = "auto",
) -> Floats | None:
    """The share of the direct light that `scale_photos` takes out of a photo, (h, w); None
    where it takes out none."""
    share, border = find_removed_direct(photo, recipe, shots, cells, normalise=normalise)
    if border is None:
        return share
    return border.share() + (0.0 if share is None else share)


def find_removed_direct(
    photo: RecipePhoto,
    recipe: Recipe,
    shots: Mapping[str, RealisedShot],
    cells: CellMap,
    *,
    normalise: NormaliseName = "auto",
) -> tuple[Floats | None, BorderLight | None]:
    """The share of the direct light that `scale_photos` takes out of a photo amid cells,
    (h, w), and the light along their borders that it takes out; None each where it takes none."""
    if not _unmixes(photo, list_white_photos(recipe)):
        return None, None
    weights = weigh_cells(photo, shots, normalise)
    of_quads = weigh_quads(weights, cells)
    share = compute_direct_share(weights.realised, of_quads, cells)
    return share, _border_of(weights.realised, of_quads, cells)


def _weigh_quads(weights: CellWeights, cells: CellMap) -> QuadWeights:
    """What to divide the quads of a photo by. Where panels draw borders of cells apart, a photo of
    direct light alone is dark, and these quads are divided by less."""
    of_quads = weigh_quads(weights, cells)
    if weights.photo.wanted.uniform != (1.0, 0.0):
        return of_quads
    border = _border_of(weights.realised, of_quads, cells)
    return of_quads if border is None else border.weigh_direct(of_quads)


def _border_of(realised: Factors, of_quads: QuadWeights, cells: CellMap) -> BorderLight | None:
    if not realised.apart:
        return None
    from pdcd.pictures.border_light import BorderLight  # most benches have no such borders

    return BorderLight.of(realised, of_quads, cells)


def _unmixes(photo: RecipePhoto, white: list[str]) -> bool:
    """Whether direct light is taken out: of indirect light, where there is a white photo."""
    return bool(white) and photo.wanted.uniform == (0.0, 1.0)


def find_telling_photo(recipe: Recipe) -> RecipePhoto | None:
    """The photo of an answer whose parts tell of direct light that gets past the codes: of all
    indirect light, beside a white photo; else the only one, if it has no direct light. None for
    other answers, and for too few parts. For darkrooms, and the verdict on codes that do not meet.
    """
    photos = recipe.answer_photos
    found = [photo for photo in photos if photo.wanted.uniform == (0.0, 1.0)]
    if not list_white_photos(recipe) or not found:
        found = [photo for photo in photos if not photo.wanted.diagonal().any()]
        found = found if len(photos) == 1 else []
    added = sum(sign > 0.0 for photo in found[:1] for sign, _ in photo.shots)
    return found[0] if added >= FEWEST_TELLING_PARTS else None


def list_white_photos(recipe: Recipe) -> list[str]:
    """Names of the photos of all light."""
    return [photo.name for photo in recipe.photos if photo.wanted.uniform == (1.0, 1.0)]


def _scaled(
    taken: Sequence[tuple[float, ExposedShot]],
    weights: QuadWeights,
    more: Floats | None,
    outside: Bools | None,
) -> Picture:
    """A signed sum of shots over its weight, `more` added; unknown `outside` the field."""
    first = taken[0][1]
    shape = *first.saturated.shape, first.light_at(slice(0, 1)).shape[-1]
    image, sigma = (
        make_planar_image(shape),
        make_planar_image(shape, first.variance_at(slice(0, 1)).dtype),
    )

    def band(rows: slice) -> None:
        weight = weights.quads_s[rows, :, None] if weights.quads_s.ndim else weights.quads_s
        error = np.sqrt(sum_weighted((1.0, shot.variance_at(rows)) for _, shot in taken))
        error /= weight.astype(error.dtype)
        unknown = np.logical_or.reduce([shot.saturated[rows] for _, shot in taken])
        for lost in (weights.blind, outside):
            if lost is not None:
                unknown |= lost[rows]
        np.copyto(error, np.inf, where=unknown[..., None])
        sigma[rows] = error
        light = sum_weighted((sign, shot.light_at(rows)) for sign, shot in taken) / weight
        if more is not None:
            light += more[rows]
        if outside is not None:
            np.copyto(light, 0.0, where=outside[rows, :, None])
        image[rows] = light

    run_in_bands(image.shape[0], band)
    return Picture(image, sigma)


def _without_room(photo: Picture, weights: CellWeights, room: Floats, cells: CellMap) -> Picture:
    """A photo without the room's light, (N, C) of cells in a second, for the time for which its
    mask was open beyond its black exposures. It is shared out among a cell's quads by their light.
    """
    opened = weights.realised.open_s / weights.cells_s
    if not (np.abs(opened) > _LEAST_OPEN).any():
        return photo
    light = cells.mean(photo.image)
    return add_missing_light(photo, light, -opened[:, None] * room, cells, weights.realised.fine)


def remove_direct_light(photo: Picture, white: Picture, share: Floats) -> Picture:
    """A photo of indirect light, and its error bar, without the direct light that got into it.

    Slow panels, and black that is not black, let a share r of the direct light through; the
    realised probing matrix gives r for each quad. A white photo is W = D + I, the coded one
    C = I + r D, both over their weights. So I = (C - r W) / (1 - r). Where the white photo is
    saturated nothing is removed, and the error bar grows by r times the light of a full quad.

    share : (h, w) of the direct light that the photo has
    (`pdcd.pictures.to_quads.compute_direct_share`).
    """
    image, sigma = (
        make_planar_image(photo.image.shape),
        make_planar_image(photo.sigma.shape, photo.sigma.dtype),
    )

    def band(rows: slice) -> None:
        known, r = np.isfinite(white.sigma[rows]), share[rows, :, None]
        removed = np.where(known, r, 0.0)
        image[rows] = (photo.image[rows] - removed * white.image[rows]) / (1.0 - removed)
        noise = r * np.where(known, white.sigma[rows], np.abs(white.image[rows]))
        sigma[rows] = np.hypot(photo.sigma[rows], noise) / (1.0 - removed)

    run_in_bands(photo.image.shape[0], band)
    return Picture(image, sigma)
