"""A picture with its error bars, and pictures that are sums of others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.recipes.recipe import Extremes, Recipe, Rule
from pdcd.sensor.bands import fill_in_bands

Errors = NDArray[np.floating]
"""Error bars: float64, or float32 where a frame is large."""
_Kind = Literal["measured", "sensor", "whole"]
"""How the error by codes is known: "measured" by the spread of parts; not at all, so that sigma is
the "sensor"'s; or there is none, as in a white photo, so that sigma is the "whole" error."""

ErrorCause = Literal["codes", "maps", "timing", "stops"]
"""Where a part of the code error comes from: codes; where panels and camera lie; when panels
switch; how much light the stops of a lens let through."""

_F = TypeVar("_F", np.float64, np.floating)


@dataclass(frozen=True)
class Picture:
    """`image` (h, w, C) float64 and `sigma`, its error bar, in scene units; C is 3, or 1 for a
    camera without colours.

    A picture is of quads, or of cells: then it is (rows, cols, C). Sigma is inf where nothing is
    known: where a quad is saturated, blind or not wholly in the field, or too little of a cell is
    seen. Outside the field the image is 0.
    """

    image: Floats
    sigma: Errors


@dataclass(frozen=True)
class PictureWithErrors(Picture):
    """A picture with its whole error: ``sigma^2 = sensor^2 + code^2``, (h, w, C) each, float64 or,
    where the frame is large, float32.

    `kind` is how `code` was found. `of_cells` is the code error of means over cells,
    (rows, cols, C), where it is known better than from their quads. `causes` are the mean squares
    of `code` by cause, whose sum is that of all; empty before they were worked out.
    """

    sensor: Errors
    code: Errors
    kind: _Kind
    of_cells: Errors | None = None
    causes: Mapping[ErrorCause, float] = field(default_factory=dict)


def with_error_bars(picture: Picture, code: Errors, kind: _Kind) -> PictureWithErrors:
    """A picture whose sigma is the sensor's, completed by the code error (h, w, C)."""
    return PictureWithErrors(
        picture.image, _together(picture.sigma, code), picture.sigma, code, kind
    )


def add_code_error(picture: PictureWithErrors, error: Errors) -> PictureWithErrors:
    """A picture with one more error (h, w, C) in its code error. Its `of_cells` is dropped."""
    code = np.hypot(picture.code, error).astype(picture.code.dtype)
    return with_error_bars(Picture(picture.image, picture.sensor), code, picture.kind)


def _together(sensor: Errors, code: Errors) -> Errors:
    """Root of the sum of squares. Written out for float32, where the library's function takes ten
    times as long."""
    if sensor.dtype != np.float32:
        return np.asarray(np.hypot(sensor, code))

    def total(rows: slice) -> Errors:
        squares = sensor[rows] * sensor[rows]
        squares += code[rows] * code[rows]
        return np.sqrt(squares, out=squares)

    return fill_in_bands(sensor.shape, sensor.dtype, total)


def combine_photos(recipe: Recipe, photos: Mapping[str, Picture]) -> dict[str, Picture]:
    """All pictures that the recipe makes of scaled photos, the answer first."""
    sigmas = {name: photo.sigma for name, photo in photos.items()}
    return {
        name: Picture(_image_of(rule, photos), compute_sigma(rule, photos, sigmas))
        for name, rule in recipe.pictures.items()
    }


def compute_sigma(
    rule: Rule, photos: Mapping[str, Picture], sigmas: Mapping[str, Errors]
) -> Errors:
    """Standard deviation of a picture, from those of its photos, which are independent."""
    if isinstance(rule, Extremes):
        return _sigma_of_extremes(rule, photos, sigmas)
    if len(rule) == 1 and rule[0][0] == 1.0:
        return sigmas[rule[0][1]]
    first = sigmas[rule[0][1]]

    def sigma(rows: slice) -> Errors:
        return np.asarray(
            np.sqrt(sum_weighted((c * c, sigmas[name][rows] ** 2) for c, name in rule))
        )

    return fill_in_bands(first.shape, first.dtype, sigma)


def _image_of(rule: Rule, photos: Mapping[str, Picture]) -> Floats:
    if isinstance(rule, Extremes):
        images = [photos[name].image for name in rule.photos]
        largest, smallest = np.array(images[0]), np.array(images[0])
        for image in images[1:]:
            np.maximum(largest, image, out=largest)
            np.minimum(smallest, image, out=smallest)
        return sum_weighted([(rule.largest, largest), (rule.smallest, smallest)])
    first = photos[rule[0][1]].image
    if len(rule) == 1 and rule[0][0] == 1.0:
        return first
    terms = [(c, photos[name].image) for c, name in rule]
    return fill_in_bands(
        first.shape, first.dtype, lambda rows: sum_weighted((c, image[rows]) for c, image in terms)
    )


def _sigma_of_extremes(
    rule: Extremes, photos: Mapping[str, Picture], sigmas: Mapping[str, Errors]
) -> Errors:
    """Sigma is that of the two photos chosen, to first order. It ignores that noise itself picks
    the extremes, which makes their difference too large by about two sigma where all photos are
    alike. Where any photo is saturated nothing is known of the extremes."""
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


def sum_weighted(terms: Iterable[tuple[float, NDArray[_F]]]) -> NDArray[_F]:
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
