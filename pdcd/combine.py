"""Shots -> answer and its standard deviation, in the scene's own units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.realised import Factors, signed_sum
from pdcd.recipe import Combination, Recipe
from pdcd.report import weight_s

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
        weight = weight_s(realised_photo(photo.shots, shots), photo.wanted)
        if not weight > 0.0:
            raise DecodeError(
                f"photo {photo.name} has no light on the paths it is to keep",
                hint="look at frames.csv: did the panels show the codes while the shutter was open",
            )
        light = _sum(sign * shots[name].light for sign, name in photo.shots)
        variance = _sum(shots[name].variance for _, name in photo.shots)
        blown = np.logical_or.reduce([shots[name].saturated for _, name in photo.shots])
        sigma = np.sqrt(variance) / weight
        sigma[blown] = np.inf
        scaled[photo.name] = Picture(light / weight, sigma)
    return {name: _combination(parts, scaled) for name, parts in recipe.pictures.items()}


def realised_photo(terms: Combination, shots: Mapping[str, Exposed]) -> Factors:
    """Realised probing matrix of a signed sum of shots."""
    return signed_sum((sign, shots[name].realised) for sign, name in terms)


def _combination(parts: Combination, photos: Mapping[str, Picture]) -> Picture:
    image = _sum(c * photos[name].image for c, name in parts)
    variance = _sum(c * c * photos[name].sigma ** 2 for c, name in parts)
    return Picture(image, np.sqrt(variance))


def _sum(arrays: Iterable[Floats]) -> Floats:
    return np.asarray(np.sum(list(arrays), axis=0))
