"""Shots -> answer and its standard deviation, in the scene's own units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.realised import Factors, signed_sum
from pdcd.recipe import Combination, Photo, Recipe
from pdcd.report import row_weights_s, weight_s

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Exposed:
    """A developed shot.

    light, variance : (h, w, 3) float64
        Scene units times seconds, signed, and its variance by the sensor model.
    saturated : (h, w) bool
    realised : the probing matrix that the panels really gave it.
    exif : what its RAW file says of itself.
    """

    light: Floats
    variance: Floats
    saturated: NDArray[np.bool_]
    realised: Factors
    exif: dict[str, Any]


@dataclass(frozen=True)
class Picture:
    """`image` and `sigma` (h, w, 3) float64 in scene units; sigma is inf where saturated."""

    image: Floats
    sigma: Floats


def combine(recipe: Recipe, shots: Mapping[str, Exposed]) -> dict[str, Picture]:
    """All pictures of a recipe, the answer first.

    Each photo is divided by its own least-squares weight before photos are subtracted (erratum
    X9). Shots are independent, so variances add with the squares of their factors. Raises
    DecodeError when a photo gathered no light at all.
    """
    scaled: dict[str, Picture] = {}
    for photo in recipe.photos:
        realised = realised_photo(photo.shots, shots)
        light = _sum(sign * shots[name].light for sign, name in photo.shots)
        variance = _sum(shots[name].variance for _, name in photo.shots)
        blown = np.logical_or.reduce([shots[name].saturated for _, name in photo.shots])
        weight = _weight(photo, realised, light.shape[:2])
        sigma = np.sqrt(variance) / weight
        sigma[blown] = np.inf
        scaled[photo.name] = Picture(light / weight, sigma)
    return {name: _combination(parts, scaled) for name, parts in recipe.pictures.items()}


def _weight(photo: Photo, realised: Factors, shape: tuple[int, int]) -> Floats:
    """What to divide a photo by, (h, w, 1) or one number: see `Photo.row_weights`."""
    common = weight_s(realised, photo.wanted)
    if not common > 0.0:
        raise DecodeError(
            f"photo {photo.name} has no light on the paths it is to keep",
            hint="look at frames.csv: did the panels show the codes while the shutter was open",
        )
    if not photo.row_weights:
        return np.array(common)
    inner, norm = row_weights_s(realised, photo.wanted)
    usable = (norm > 0.0) & (inner > 0.0)
    own = np.where(usable, inner / np.where(norm > 0.0, norm, 1.0), common)
    cells = own.reshape(photo.wanted.grid)
    per_cell = (shape[0] // cells.shape[0], shape[1] // cells.shape[1])
    return cells.repeat(per_cell[0], axis=0).repeat(per_cell[1], axis=1)[..., None]


def realised_photo(terms: Combination, shots: Mapping[str, Exposed]) -> Factors:
    """Realised probing matrix of a signed sum of shots."""
    return signed_sum((sign, shots[name].realised) for sign, name in terms)


def _combination(parts: Combination, photos: Mapping[str, Picture]) -> Picture:
    image = _sum(c * photos[name].image for c, name in parts)
    variance = _sum(c * c * photos[name].sigma ** 2 for c, name in parts)
    return Picture(image, np.sqrt(variance))


def _sum(arrays: Iterable[Floats]) -> Floats:
    return np.asarray(np.sum(list(arrays), axis=0))
