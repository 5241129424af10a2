"""Shots -> answer and its standard deviation, in the scene's own units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.probing.deviation import row_weights_s, weight_s
from pdcd.probing.realised import Factors, signed_sum
from pdcd.recipes.recipe import Combination, Extremes, Photo, Recipe, Rule
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

Floats = NDArray[np.float64]


class Shown(Protocol):
    """What the panels really did in a shot; no light is needed to know it."""

    @property
    def realised(self) -> Factors:
        """The probing matrix that they gave it."""
        ...

    @property
    def missed(self) -> int:
        """Refreshes that came late or never, where that left codes with unequal light."""
        ...


@dataclass(frozen=True)
class Matrix:
    """What the panels did in a shot whose light nobody asked for."""

    realised: Factors
    missed: int = 0


@dataclass(frozen=True)
class Exposed:
    """A developed shot.

    light, variance : (h, w, 3) float64
        Scene units times seconds, signed, and its variance by the sensor model.
    saturated : (h, w) bool
    realised : the probing matrix that the panels really gave it.
    exif : what its RAW file says of itself.
    missed : refreshes that came late or never, where that left codes with unequal light.
    """

    light: Floats
    variance: Floats
    saturated: NDArray[np.bool_]
    realised: Factors
    exif: dict[str, object]
    missed: int = 0


@dataclass(frozen=True)
class Picture:
    """`image` and `sigma` (h, w, 3) float64 in scene units; sigma is inf where saturated."""

    image: Floats
    sigma: Floats


def combine(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    cells: CellMap,
    added: Mapping[str, Floats] | None = None,
    *,
    normalise: NormaliseName = "auto",
) -> dict[str, Picture]:
    """All pictures of a recipe, the answer first.

    `cells` tells which pixels see which cell. `added` holds what is known to be missing from a
    photo, (h, w, 3) in scene units.

    Each photo is divided by its own least-squares weight before photos are subtracted (erratum
    X9). Shots are independent, so variances add with the squares of their factors. Raises
    DecodeError when a photo gathered no light at all.

    With `normalise` "row" each cell is divided by its own weight instead, with "scalar" none is;
    "auto" does so for photos whose codes ask for it and for those that missed refreshes: lost codes
    leave cells open unequally often, as the paper's random codes do.
    """
    return pictures_of(recipe, scaled_photos(recipe, shots, cells, added, normalise=normalise))


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
    for photo in recipe.photos:
        realised = realised_photo(photo.shots, shots)
        light = _sum(sign * shots[name].light for sign, name in photo.shots)
        variance = _sum(shots[name].variance for _, name in photo.shots)
        blown = np.logical_or.reduce([shots[name].saturated for _, name in photo.shots])
        weight = cell_weights_s(photo, realised, by_row=divided_by_row(photo, shots, normalise))
        if weight.ndim:
            weight = cells.spread(weight)[..., None]
        sigma = np.sqrt(variance) / weight
        sigma[blown] = np.inf
        image = light / weight + (0.0 if added is None else added.get(photo.name, 0.0))
        scaled[photo.name] = Picture(image, sigma)
    return scaled


def pictures_of(recipe: Recipe, photos: Mapping[str, Picture]) -> dict[str, Picture]:
    """All pictures that the recipe makes of scaled photos, the answer first."""
    return {name: _combination(rule, photos) for name, rule in recipe.pictures.items()}


def divided_by_row(photo: Photo, shots: Mapping[str, Shown], normalise: NormaliseName) -> bool:
    """Whether each cell of a photo is divided by its own weight; see `combine`."""
    if normalise == "auto":
        return photo.row_weights or any(shots[name].missed for _, name in photo.shots)
    return normalise == "row"


def cell_weights_s(photo: Photo, realised: Factors, *, by_row: bool) -> Floats:
    """What to divide a photo by: one number (), or that of each cell's row (N,)."""
    common = weight_s(realised, photo.wanted)
    if not common > 0.0:
        raise DecodeError(
            f"photo {photo.name} has no light on the paths it is to keep",
            hint="look at frames.csv: did the panels show the codes while the shutter was open",
        )
    if not by_row:
        return np.array(common)
    inner, norm = row_weights_s(realised, photo.wanted)
    usable = (norm > 0.0) & (inner > 0.0)
    own: Floats = np.where(usable, inner / np.where(norm > 0.0, norm, 1.0), common)
    return own


def realised_photo(terms: Combination, shots: Mapping[str, Shown]) -> Factors:
    """Realised probing matrix of a signed sum of shots."""
    return signed_sum((sign, shots[name].realised) for sign, name in terms)


def _combination(rule: Rule, photos: Mapping[str, Picture]) -> Picture:
    if isinstance(rule, Extremes):
        return _extremes(rule, photos)
    image = _sum(c * photos[name].image for c, name in rule)
    variance = _sum(c * c * photos[name].sigma ** 2 for c, name in rule)
    return Picture(image, np.sqrt(variance))


def _extremes(rule: Extremes, photos: Mapping[str, Picture]) -> Picture:
    """Sigma is that of the two photos chosen, to first order: it does not know that noise itself
    picks the extremes, which makes their difference too large by about two sigma where all photos
    are alike. Where any photo is saturated nothing is known of the extremes."""
    images = np.stack([photos[name].image for name in rule.photos])
    sigmas = np.stack([photos[name].sigma for name in rule.photos])
    known = np.isfinite(sigmas).all(axis=0)
    image, variance = np.zeros(images.shape[1:]), np.zeros(images.shape[1:])
    chosen = ((rule.largest, images.argmax(axis=0)), (rule.smallest, images.argmin(axis=0)))
    for factor, index in chosen:
        image += factor * np.take_along_axis(images, index[None], axis=0)[0]
        sigma = np.take_along_axis(sigmas, index[None], axis=0)[0]
        variance += (factor * np.where(known, sigma, 0.0)) ** 2
    return Picture(image, np.where(known, np.sqrt(variance), np.inf))


def _sum(arrays: Iterable[Floats]) -> Floats:
    return np.asarray(np.sum(list(arrays), axis=0))
