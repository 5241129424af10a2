"""The error of a picture by its codes, from the spread of its parts; and by light from right beside
each cell, which all parts get wrong alike.

The spread of parts is measured on cells, and on single quads besides: where quads get light by
paths of their own, as in rough stone, their error is larger than that of their cell's mean.

The code error depends on the light transport of the scene, which nobody knows. Where a photo was
taken in parts with codes of their own, their spread shows it. Where it was not, nothing does: one
photo cannot separate the light of a mirror from that of a wall, and sigma is without it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from pdcd.arrays import Floats
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.picture import Picture, PictureWithErrors, sum_weighted, with_error_bars
from pdcd.pictures.quad_samples import SAMPLED, QuadSample, sample_quads
from pdcd.pictures.smooth import average_neighbour_weights
from pdcd.pictures.to_cells import average_light, choose_part_cells
from pdcd.pictures.weights import CellWeights
from pdcd.recipes.parts import list_parts
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap

_CONFIDENCE = 0.95
"""Share of pixels whose true value is to lie within image +- 1.96 sigma."""
_NEIGHBOURS_PX = 3
"""Side of the square of pixels whose spreads are pooled."""
_LEAST = 0.1
"""Least square of a pixel's error over that of its neighbourhood. A larger one covers more of what
parts get wrong alike, and widens the error bars of pixels that are right."""
_DARK = 1e-3
"""Mean square of the light, over that of all cells, below which a cell is dark."""
_ROUNDED = 1e-6
"""Share of the mean below which a sum over cells is rounding error."""
_MOST_TOLD = 0.5
"""Share of half cells with two quads or more from which errors of quads are estimated on halves."""
_LEAST_BESIDE = 0.15
"""Wrong weight, in paths of one cell, below which it is the chance of codes: photos of whole cells
have nothing else."""


def measure_error_bars(
    picture: Picture, parts: Sequence[Floats], over: int | None = None
) -> PictureWithErrors:
    """A picture with the code error that the spread of its parts, (h, w, C) each, shows.

    over : how many of the parts the picture is the mean of, if not of all. In a set the other parts
    help to estimate its error.

    The mean of B independent parts has 1/B of their variance. B is small, so that the variance of
    one pixel is itself uncertain; `_moderated` steadies it by its neighbours. The remaining
    uncertainty widens sigma by a factor of Student's t, so that 1.96 sigma cover 95 %. The part of
    the spread that the sensor's noise explains is not counted twice.

    Parts may also agree by chance: where all of them count a single path equally often, or never,
    it is wrong in all and none differs. So a pixel amid errors above the average has at least the
    share `_LEAST` of their mean square.

    A pixel saturated in any part keeps its infinite sigma.
    """
    variance = np.var(np.stack(parts), axis=0, ddof=1) / (over or len(parts))
    noise = np.where(np.isfinite(picture.sigma), picture.sigma, 0.0) ** 2
    code = np.empty_like(variance)
    for channel in range(variance.shape[-1]):
        seen, least = variance[..., channel], noise[..., channel]
        expected = _expected(seen, least, picture.image[..., channel])
        ratio, freedom = _moderated(seen / expected, len(parts) - 1)
        tail = (1.0 - _CONFIDENCE) / 2.0
        wider = scipy.special.stdtrit(freedom, tail) / scipy.special.ndtri(tail)
        square = np.maximum(wider**2 * ratio * expected - least, 0.0)
        square = np.maximum(square, _LEAST * _strong_around(square))
        code[..., channel] = np.sqrt(square)
    return with_error_bars(picture, code, "measured")


def _strong_around(square: Floats) -> Floats:
    """Mean of squares (h, w) over each neighbourhood where it exceeds the overall mean; else 0."""
    around: Floats = scipy.ndimage.uniform_filter(square, _NEIGHBOURS_PX, mode="nearest")
    return np.where(around > square.mean(), around, 0.0)


def _expected(variance: Floats, noise: Floats, image: Floats) -> Floats:
    """Variances (h, w) as they would be if code error were everywhere the same share of the light.

    Only their proportions matter: they keep edges of the scene from looking like chance. All > 0.
    """
    square = image**2
    total = float(square.sum())
    share = max(float(np.sum(variance - noise)), 0.0) / total if total > 0.0 else 0.0
    expected = noise + share * square
    floor = _DARK * float(expected.mean())
    return np.maximum(expected, floor if floor > 0.0 else 1.0)


def _moderated(variance: Floats, freedom: int) -> tuple[Floats, float]:
    """Estimated variances (h, w) -> steadier ones, and the degrees of freedom they then have.

    Each is averaged with that of its neighbourhood, which counts for as many degrees of freedom as
    true variances are alike there: many where only chance makes the estimates differ, few where
    they differ by more. (An empirical Bayes estimate: true variances scatter about that of the
    neighbourhood like an inverse chi-square, whose scatter follows from the mean and variance of
    the logarithms; Smyth 2004.)
    """
    square = np.full((_NEIGHBOURS_PX, _NEIGHBOURS_PX), _NEIGHBOURS_PX**-2.0)
    pool = scipy.ndimage.convolve(variance, square, mode="nearest")
    seen = (variance > 0.0) & (pool > 0.0)
    if not seen.any():
        return pool, np.inf
    logs = np.log(variance[seen] / pool[seen])
    half = freedom / 2.0
    excess = float(np.var(logs)) - float(scipy.special.polygamma(1, half))
    prior = 2.0 * _inverse_trigamma(excess) if excess > 0.0 else np.inf
    shift = float(np.mean(logs)) - scipy.special.digamma(half) + np.log(half)
    if np.isinf(prior):
        return pool * np.exp(shift), np.inf
    shift += scipy.special.digamma(prior / 2.0) - np.log(prior / 2.0)
    steady = (prior * pool * np.exp(shift) + freedom * variance) / (prior + freedom)
    return steady, prior + freedom


def _inverse_trigamma(value: float) -> float:
    """x with trigamma(x) = value > 0, by Newton's method on its reciprocal, which is convex."""
    x = 0.5 + 1.0 / value
    for _ in range(20):
        trigamma = float(scipy.special.polygamma(1, x))
        x += trigamma * (1.0 - trigamma / value) / float(scipy.special.polygamma(2, x))
    return x


def estimate_photo_quad_errors(
    recipe: Recipe,
    shots: Mapping[str, ExposedShot],
    photos: Mapping[str, Picture],
    cells: CellMap,
) -> dict[str, Floats]:
    """Errors of single quads by codes, relative to the mean of their cell, or of half a cell where
    parts are of halves (`estimate_quad_shares`); of all photos with codes, by name.

    photos : scaled ones. The result is empty where each cell has a quad of its own.
    """
    parted, count = choose_part_cells(cells), len(list_parts(recipe))
    used = [shots[name] for name in {name for photo in recipe.photos for _, name in photo.shots}]
    picked = sample_part_quads(used, cells)
    if picked is None:
        return {}
    return {
        name: to_quad_errors(share / count, average_light(photos[name], parted))
        for name, share in estimate_photo_quad_shares(recipe, shots, picked).items()
    }


def estimate_photo_quad_shares(
    recipe: Recipe, shots: Mapping[str, ExposedShot], picked: QuadSample
) -> dict[str, Floats]:
    """The same for one part, as squares over those of its light (`estimate_quad_shares`)."""
    found: dict[str, Floats] = {}
    numbers = list_parts(recipe)
    for photo in recipe.photos:
        light, noise = [], []
        for number in numbers:
            names = {shot.name for shot in recipe.shots if shot.part == number}
            taken = [(sign, shots[name]) for sign, name in photo.shots if name in names]
            if taken:
                light.append(sum_weighted((sign, picked.take(one.light_at)) for sign, one in taken))
                noise.append(sum_weighted((1.0, picked.take(one.variance_at)) for _, one in taken))
        if light:
            found[photo.name] = estimate_quad_shares(light, noise, picked)
    return found


def sample_part_quads(
    used: Sequence[ExposedShot], cells: CellMap, along: int = SAMPLED
) -> QuadSample | None:
    """The quads that `estimate_photo_quad_errors` uses; None where each cell has one. along : of
    `pdcd.pictures.quad_samples.sample_quads`."""
    parted = choose_part_cells(cells)
    picked = sample_quads(used, parted, along=along)
    if parted is not cells and picked.share_told() < _MOST_TOLD:  # blur mixes halves everywhere
        picked = sample_quads(used, cells, along=along)
    return picked if picked.share_told() else None


def to_quad_errors(share: Floats, images: Floats) -> Floats:
    """Errors of single quads by codes, relative to the mean of their cell, (rows, cols, C), without
    the sensor's noise.

    share : squares of their errors over those of the light (`estimate_quad_shares`), divided by the
    number of parts of the photo. images : (rows, cols, C), the photo on these cells or on halves,
    in the unit of the answer.
    """
    pieces = images.shape[0] // share.shape[0]
    share = share.repeat(pieces, 0).repeat(pieces, 1)
    return np.asarray(np.sqrt(share) * np.abs(images))


def estimate_quad_shares(
    light: Sequence[Floats], noise: Sequence[Floats], picked: QuadSample
) -> Floats:
    """Square of the error of single quads of one part by codes, relative to the mean of their cell,
    over the square of its light, (rows, cols, C). It is estimated from how quads deviate from that
    mean in the parts of a photo.

    light, noise : of each part at the picked quads, (Q, C), and its variance, in any unit. Cells
    where no quad was picked get the overall value.
    """
    count, mean = len(light), np.mean(light, axis=0)
    number = np.maximum(picked.sums(np.ones((picked.cell.size, 1))), 1.0)
    level = picked.sums(mean) / number
    floor = _DARK * np.mean(level**2, axis=0)
    lit = level > np.sqrt(floor)
    square = np.zeros_like(mean)
    for part in light:
        like = np.divide(picked.sums(part) / number, level, out=np.ones_like(level), where=lit)
        like = like[picked.cell]
        square += (part - mean * like) ** 2 / (count - 1.0)
    spare = np.maximum(number - 1.0, 0.0) / number  # the mean of a cell uses one degree of freedom
    square -= spare[picked.cell] * np.mean(noise, axis=0)
    # In proportion to light; cells that are dark compared with the others have as small an error.
    all_light = picked.sums(spare[picked.cell] * (level**2 + floor)[picked.cell], _NEIGHBOURS_PX)
    # Means over squares leave rounding where no quad was picked.
    told = all_light > _ROUNDED * all_light.mean(axis=0)
    all_square = picked.sums(square, _NEIGHBOURS_PX)
    share = np.broadcast_to(all_square.sum(axis=0) / all_light.sum(axis=0), told.shape).copy()
    np.divide(all_square, all_light, out=share, where=told)
    return np.asarray(np.maximum(share, 0.0).reshape(*picked.grid, -1))


def compute_neighbour_weight(weights: CellWeights, grid: tuple[int, int]) -> float:
    """Weight with which light from one of the cells around enters the error of a photo that cannot
    separate it from direct light. It combines what is lacking of all eight and what is there of the
    cell's own light, whose amount is unknown. 0 where only the chance of codes is left, and for
    photos that do not want all other cells alike.

    Under quarter windows the projector's code cell reaches a quarter of a cell beyond the window
    that it belongs to. So a photo of indirect light lacks some of the light from the cells around,
    and has some of the light that wandered within its own. All parts of a photo do so alike, so
    that their spread does not show it (`pdcd.pictures.beside`).
    """
    uniform = weights.photo.wanted.uniform
    if uniform is None or uniform[0] == uniform[1]:
        return 0.0
    diagonal, off = uniform
    realised, cells_s = weights.realised, weights.cells_s
    lacking = sum(
        off - share
        for share in average_neighbour_weights(
            realised.left, realised.right, cells_s, grid
        ).values()
    )
    own = float(np.mean(realised.row_sums_s[1] / cells_s)) - diagonal
    weight = float(np.hypot(lacking, own))
    return 0.0 if weight < _LEAST_BESIDE else weight
