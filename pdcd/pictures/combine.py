"""Shots -> answer and its standard deviation, in the scene's own units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.exposed import Errors, Exposed
from pdcd.pictures.unmixed import direct_share, unmixed
from pdcd.pictures.weights import (
    Bools,
    Floats,
    Shown,
    Weights,
    cell_weights_s,
    divided_by_row,
    quad_weights_s,
    realised_photo,
)
from pdcd.probing.realised import Factors
from pdcd.recipes.recipe import Extremes, Photo, Recipe, Rule
from pdcd.sensor.bands import banded, in_bands, planar
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

__all__ = [
    "Errors",
    "Exposed",
    "Floats",
    "Matrix",
    "Picture",
    "Shown",
    "cell_weights_s",
    "combine",
    "divided_by_row",
    "pictures_of",
    "realised_photo",
    "scaled_photos",
    "share_taken_out",
    "sigma_of",
    "white_of",
]

_F = TypeVar("_F", np.float64, np.floating)


@dataclass(frozen=True)
class Matrix:
    """What the panels did in a shot whose light nobody asked for."""

    realised: Factors
    missed: int = 0


@dataclass(frozen=True)
class Picture:
    """`image` (h, w, 3) float64 and `sigma`, its error bar, in scene units.

    Sigma is inf where nothing is known: where a quad is saturated, blind or not wholly in the
    field. Outside the field the image is 0.
    """

    image: Floats
    sigma: Errors


def combine(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    cells: CellMap,
    added: Mapping[str, Floats] | None = None,
    *,
    normalise: NormaliseName = "auto",
) -> dict[str, Picture]:
    """All pictures of a recipe, the answer first.

    `cells` tells which quads see which cell. `added` holds what is known to be missing from a
    photo, (h, w, 3) in scene units.

    Each photo is divided by its own least-squares weight before photos are subtracted (erratum
    X9). Shots are independent, so variances add with the squares of their factors. Raises
    DecodeError when a photo gathered no light at all.

    With `normalise` "row" each cell is divided by its own weight instead, with "scalar" none is;
    "auto" does so for photos whose codes ask for it and for those that missed refreshes: lost codes
    leave cells open unequally often, as the paper's random codes do. Either way each quad's weight
    is that of the windows that it saw (`pdcd.pictures.weights`).

    Direct light that is known to be in a photo of indirect light is taken out
    (`pdcd.pictures.unmixed`), where there is a white photo.
    """
    photos = scaled_photos(recipe, shots, cells, added, normalise=normalise)
    return pictures_of(recipe, photos)


def scaled_photos(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    cells: CellMap,
    added: Mapping[str, Floats] | None = None,
    *,
    normalise: NormaliseName = "auto",
) -> dict[str, Picture]:
    """Every photo of a recipe divided by its weight; arguments as of `combine`."""
    scaled: dict[str, Picture] = {}
    direct: dict[str, Floats] = {}
    white = white_of(recipe)
    outside = None if cells.known.all() else ~cells.known
    for photo in recipe.photos:
        realised = realised_photo(photo.shots, shots)
        by_row = divided_by_row(photo, shots, normalise)
        weights = quad_weights_s(photo, realised, shots, cells, by_row=by_row)
        taken = [(sign, shots[name]) for sign, name in photo.shots]
        more = None if added is None else added.get(photo.name)
        scaled[photo.name] = _scaled(taken, weights, more, outside)
        if _unmixes(photo, white):
            share = direct_share(realised, weights, cells)
            if share is not None:
                direct[photo.name] = share
    for name, share in direct.items():
        one, whole = scaled[name], scaled[white[-1]]
        scaled[name] = Picture(*unmixed(one.image, one.sigma, whole.image, whole.sigma, share))
    return scaled


def share_taken_out(
    photo: Photo,
    recipe: Recipe,
    shots: Mapping[str, Shown],
    cells: CellMap,
    *,
    normalise: NormaliseName = "auto",
) -> Floats | None:
    """The share of the direct light that `scaled_photos` takes out of a photo, (h, w); None where
    it takes out none."""
    if not _unmixes(photo, white_of(recipe)):
        return None
    realised = realised_photo(photo.shots, shots)
    by_row = divided_by_row(photo, shots, normalise)
    weights = quad_weights_s(photo, realised, shots, cells, by_row=by_row)
    return direct_share(realised, weights, cells)


def _unmixes(photo: Photo, white: list[str]) -> bool:
    """Whether direct light is taken out of a photo: of indirect light, beside one of all light."""
    return bool(white) and photo.wanted.uniform == (0.0, 1.0)


def white_of(recipe: Recipe) -> list[str]:
    """Names of the photos of all light."""
    return [photo.name for photo in recipe.photos if photo.wanted.uniform == (1.0, 1.0)]


def _scaled(
    taken: Sequence[tuple[float, Exposed]],
    weights: Weights,
    more: Floats | None,
    outside: Bools | None,
) -> Picture:
    """A signed sum of shots over its weight, `more` added; unknown `outside` the field."""
    first = taken[0][1]
    shape = *first.saturated.shape, 3
    image, sigma = planar(shape), planar(shape, first.variance_at(slice(0, 1)).dtype)

    def band(rows: slice) -> None:
        weight = weights.quads_s[rows, :, None] if weights.quads_s.ndim else weights.quads_s
        error = np.sqrt(_sum((1.0, shot.variance_at(rows)) for _, shot in taken))
        error /= weight.astype(error.dtype)
        unknown = np.logical_or.reduce([shot.saturated[rows] for _, shot in taken])
        for lost in (weights.blind, outside):
            if lost is not None:
                unknown |= lost[rows]
        np.copyto(error, np.inf, where=unknown[..., None])
        sigma[rows] = error
        light = _sum((sign, shot.light_at(rows)) for sign, shot in taken) / weight
        if more is not None:
            light += more[rows]
        if outside is not None:
            np.copyto(light, 0.0, where=outside[rows, :, None])
        image[rows] = light

    in_bands(image.shape[0], band)
    return Picture(image, sigma)


def pictures_of(recipe: Recipe, photos: Mapping[str, Picture]) -> dict[str, Picture]:
    """All pictures that the recipe makes of scaled photos, the answer first."""
    sigmas = {name: photo.sigma for name, photo in photos.items()}
    return {
        name: Picture(_image_of(rule, photos), sigma_of(rule, photos, sigmas))
        for name, rule in recipe.pictures.items()
    }


def sigma_of(rule: Rule, photos: Mapping[str, Picture], sigmas: Mapping[str, Errors]) -> Errors:
    """Standard deviation of a picture, from those of its photos, which are independent."""
    if isinstance(rule, Extremes):
        return _sigma_of_extremes(rule, photos, sigmas)
    if len(rule) == 1 and rule[0][0] == 1.0:
        return sigmas[rule[0][1]]
    first = sigmas[rule[0][1]]

    def sigma(rows: slice) -> Errors:
        return np.asarray(np.sqrt(_sum((c * c, sigmas[name][rows] ** 2) for c, name in rule)))

    return banded(first.shape, first.dtype, sigma)


def _image_of(rule: Rule, photos: Mapping[str, Picture]) -> Floats:
    if isinstance(rule, Extremes):
        images = [photos[name].image for name in rule.photos]
        largest, smallest = np.array(images[0]), np.array(images[0])
        for image in images[1:]:
            np.maximum(largest, image, out=largest)
            np.minimum(smallest, image, out=smallest)
        return _sum([(rule.largest, largest), (rule.smallest, smallest)])
    first = photos[rule[0][1]].image
    if len(rule) == 1 and rule[0][0] == 1.0:
        return first
    terms = [(c, photos[name].image) for c, name in rule]
    return banded(
        first.shape, first.dtype, lambda rows: _sum((c, image[rows]) for c, image in terms)
    )


def _sigma_of_extremes(
    rule: Extremes, photos: Mapping[str, Picture], sigmas: Mapping[str, Errors]
) -> Errors:
    """Sigma is that of the two photos chosen, to first order: it does not know that noise itself
    picks the extremes, which makes their difference too large by about two sigma where all photos
    are alike. Where any photo is saturated nothing is known of the extremes."""
    first = photos[rule.photos[0]].image
    largest, smallest = np.array(first), np.array(first)
    of_largest, of_smallest = (np.array(sigmas[rule.photos[0]]) for _ in range(2))
    known = np.isfinite(of_largest)
    for name in rule.photos[1:]:
        image, sigma = photos[name].image, sigmas[name]
        known &= np.isfinite(sigma)
        np.copyto(of_largest, sigma, where=image > largest)
        np.copyto(of_smallest, sigma, where=image < smallest)
        np.maximum(largest, image, out=largest)
        np.minimum(smallest, image, out=smallest)
    variance = np.zeros_like(of_largest)
    for factor, sigma in ((rule.largest, of_largest), (rule.smallest, of_smallest)):
        variance += (factor * np.where(known, sigma, 0.0)) ** 2
    found: Errors = np.where(known, np.sqrt(variance), np.inf).astype(variance.dtype)
    return found


def _sum(terms: Iterable[tuple[float, NDArray[_F]]]) -> NDArray[_F]:
    """Weighted sum of equally shaped arrays, in order, of their own type; a single one with the
    weight 1 is not copied."""
    (first, array), *rest = terms
    total: NDArray[_F] = array if first == 1.0 else np.asarray(first * array)
    for factor, more in rest:
        part: NDArray[_F] = more if factor == 1.0 else np.asarray(factor * more)
        if total is array:
            total = np.asarray(total + part)
        else:
            total += part
    return total
