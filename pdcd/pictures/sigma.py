"""How far the codes of a picture may be off: measured by its parts, or predicted by a model.

The code error depends on the light transport of the scene, which nobody knows. Where a photo was
taken in parts with codes of their own, the spread of the parts shows it. Where it was not, it must
be assumed.

A cell n gets the light ``sum_m A_nm t_nm / w`` where ``sum_m W_nm t_nm`` is wanted. The matrices A
(realised) and W are known, the paths t are not. Assumed is:

- a cell gets as much light straight back, and as much from all other cells together, as the photo
  shows around it; more straight back where the photo keeps a share of that alone;
- the latter comes from N_eff cells in equal shares, anywhere in the scene.

Over all such places the mean square error of the cell is ``S^2 (mean^2 + variance / N_eff)``, with
the mean and the variance over m of ``A_nm / w - W_nm``. For the paper's random codes this is their
known ``(S^2 + 2 Q) / K`` with ``Q = S^2 / N_eff``.

N_eff is one number for a photo, by its roughness: code errors of neighbours are unrelated, light
from elsewhere is mostly smooth. So what the picture varies from cell to cell beyond the sensor's
noise is taken to be code error. Texture of the scene, unless a white photo shows it, counts as
error too, which makes sigma too large; errors that vary slowly are not seen, which makes it too
small.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.pictures.picture import Barred, Picture, barred
from pdcd.pictures.smooth import beside
from pdcd.pictures.weights import Shown, cell_weights_s, realised_photo, weigh_cells
from pdcd.probing.deviation import row_deviations, weight_s
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import Wanted
from pdcd.recipes.recipe import Photo, Recipe
from pdcd.words import NormaliseName

Floats = NDArray[np.float64]

CONFIDENCE = 0.95
"""Share of pixels whose true value is to lie within image +- 1.96 sigma."""
NEIGHBOURS_PX = 3
"""Side of the square of pixels whose spreads are pooled."""
LEAST = 0.1
"""Least square of a pixel's error over that of its neighbourhood. More covers more of what parts
get wrong alike, and widens the error bars of pixels that do not err."""
NONE: Mapping[str, Floats] = MappingProxyType({})
RING = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]]) / 8.0
"""Mean of the eight cells around one."""
FEWEST_CELLS = 4.0
"""Least N_eff: the sharpest of the virtual scenes, a ball of mirrors, has about as much."""
MOST_FAR_CELLS = 100.0
"""Most N_eff of far light. The smooth scenes have 50 to 280, by their true errors."""
LEAST_STRAIGHT = 0.1
"""Share of light straight back, over the largest of any cell, that a photo is taken to show of it
at least."""
DARK = 0.02
"""Share of the brightest white below which a cell tells nothing of texture."""
MEDIAN_SQUARE = 0.4549
"""Median of the square of a standard normal number."""
USUAL = 0.02
"""Light from one of the eight cells around, over all indirect light, where no pilot tells: between
the virtual scenes with little of it (0.1 to 1 %) and those with much (2 to 7 %)."""
UNEVEN = 1.3
"""Root of the mean square of what the eight send, over its mean: 1.05 to 2.5 before the virtual
scenes."""
LEAST_BESIDE = 0.15
"""Weight that is off, in paths of one cell, below which it is the chance of codes: a photo of whole
cells has none but that."""


def measured(picture: Picture, parts: Sequence[Floats]) -> Barred:
    """A picture with the code error that the spread of its parts, (h, w, 3) each, shows.

    The mean of B independent parts has 1/B of their variance. B is small, so that the variance of
    one pixel is itself uncertain; `_moderated` steadies it by its neighbours. What is left of the
    uncertainty widens sigma by a factor of Student's t, so that 1.96 sigma cover 95 %. What the
    sensor's noise explains of the spread is not counted twice.

    Parts may also agree by chance: where all of them count a single path equally often, or never,
    it is wrong in all and none differs. So a pixel amid errors above the average has no less than
    the share `LEAST` of their mean square.

    A pixel saturated in any part keeps its infinite sigma.
    """
    variance = np.var(np.stack(parts), axis=0, ddof=1) / len(parts)
    noise = np.where(np.isfinite(picture.sigma), picture.sigma, 0.0) ** 2
    code = np.empty_like(variance)
    for channel in range(variance.shape[-1]):
        seen, least = variance[..., channel], noise[..., channel]
        expected = _expected(seen, least, picture.image[..., channel])
        ratio, freedom = _moderated(seen / expected, len(parts) - 1)
        tail = (1.0 - CONFIDENCE) / 2.0
        wider = scipy.special.stdtrit(freedom, tail) / scipy.special.ndtri(tail)
        square = np.maximum(wider**2 * ratio * expected - least, 0.0)
        square = np.maximum(square, LEAST * _strong_around(square))
        code[..., channel] = np.sqrt(square)
    return barred(picture, code, "measured")


def _strong_around(square: Floats) -> Floats:
    """Mean of squares (h, w) over each neighbourhood where it is above that of all; else 0."""
    around: Floats = scipy.ndimage.uniform_filter(square, NEIGHBOURS_PX, mode="nearest")
    return np.where(around > square.mean(), around, 0.0)


def _expected(variance: Floats, noise: Floats, image: Floats) -> Floats:
    """Variances (h, w) as they would be if code error were everywhere the same share of the light.

    Only their proportions matter: edges of the scene then do not look like chance. All > 0.
    """
    square = image**2
    total = float(square.sum())
    share = max(float(np.sum(variance - noise)), 0.0) / total if total > 0.0 else 0.0
    expected = noise + share * square
    floor = 1e-3 * float(expected.mean())
    return np.maximum(expected, floor if floor > 0.0 else 1.0)


def _moderated(variance: Floats, freedom: int) -> tuple[Floats, float]:
    """Estimated variances (h, w) -> steadier ones, and the degrees of freedom they then have.

    Each is averaged with that of its neighbourhood, which counts for as many degrees of freedom as
    true variances are alike there: many where only chance makes the estimates differ, few where
    they differ by more. (An empirical Bayes estimate: true variances scatter about that of the
    neighbourhood like an inverse chi-square, whose scatter follows from the mean and variance of
    the logarithms; Smyth 2004.)
    """
    square = np.full((NEIGHBOURS_PX, NEIGHBOURS_PX), NEIGHBOURS_PX**-2.0)
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


def model_errors(
    recipe: Recipe,
    shots: Mapping[str, Shown],
    coarse: Mapping[str, Picture],
    alive: Callable[[], None] = lambda: None,
    sharp: Floats | None = None,
    *,
    near: Mapping[str, Floats] = NONE,
) -> dict[str, Floats]:
    """Code errors of the photos of a recipe by the model above, (rows, cols, C) each, of cells:
    what varies between the quads of a cell is texture.

    coarse : the scaled photos on cells (`pdcd.pictures.to_cells.average`). alive : called now and
    then, may raise. sharp : (N, C), what the first photos of a pilot tell of the sharp paths of
    each cell (`pdcd.codes.pilot.scene_light`): of photos in which paths are corrected it takes the
    place of N_eff. near : errors of photos by light from right beside each cell (`beside_error`).
    Photos of far light, whose cells are each divided by their own weight, are judged by these
    weights and by the roughness of all their light. The light straight back is what the photo shows
    over the share of it that was wanted.
    """
    white = coarse["white"].image if "white" in coarse else None
    found = {}
    for photo in recipe.photos:
        picture = coarse[photo.name]
        realised = realised_photo(photo.shots, shots)
        far = photo.beyond > 0
        weight = weight_s(realised, photo.wanted)
        if far:
            realised, weight = _by_row(photo, realised), 1.0
        rows = row_deviations(realised, photo.wanted, weight, alive)
        mean, variance, diagonal = (row.reshape(*picture.image.shape[:2], 1) for row in rows)
        diagonal *= _straight(photo.wanted).reshape(diagonal.shape)
        if sharp is not None and photo.paths:
            light = _light(picture.image)
            squares = sharp.reshape(light.shape)
            error = np.sqrt(light * (mean**2 + diagonal**2) + squares * variance)
        else:
            fixed = mean**2 + diagonal**2
            error = code_error(picture, fixed, variance, photo.wanted.cells, white, far=far)
        if photo.name in near:
            error = np.hypot(error, near[photo.name])
        found[photo.name] = error
    return found


def code_error(
    picture: Picture,
    fixed: Floats,
    spread: Floats,
    cells: int,
    white: Floats | None = None,
    *,
    far: bool = False,
) -> Floats:
    """Standard deviation by the model, (rows, cols, C), in the unit of the picture.

    Parameters
    ----------
    picture : of cells; its sigma is the sensor's.
    fixed, spread : (rows, cols, 1)
        Mean square error over S^2 that does not depend on N_eff, and that which is divided by it.
    cells : most that N_eff can be.
    white : (rows, cols, C), a picture of everything, whose texture then does not count as error.
    far : of far light, which few bright places may get by single paths: the mean roughness tells,
        N_eff may be 1, and as codes of neighbours err alike on light of many cells, which is
        smooth then, at most `MOST_FAR_CELLS`.
    """
    light = _light(picture.image)
    around = np.empty_like(picture.image)
    for channel in range(light.shape[-1]):
        image = picture.image[..., channel]
        around[..., channel] = _around(image, None if white is None else white[..., channel])
    rough = (picture.image - around) ** 2 / (1.0 + 1.0 / 8.0)
    scale = light * spread
    use = (scale > 0.0) & np.isfinite(picture.sigma)
    if not use.any():
        return np.sqrt(light * fixed)
    explained = light * fixed + np.where(use, picture.sigma, 0.0) ** 2
    if far:
        sharp = float(np.sum((rough - light * fixed - picture.sigma**2)[use]) / np.sum(scale[use]))
        return np.sqrt(light * (fixed + spread * min(max(sharp, 1.0 / MOST_FAR_CELLS), 1.0)))
    share = float(np.median((rough / np.where(use, scale, 1.0))[use])) / MEDIAN_SQUARE
    share -= float(np.median((explained / np.where(use, scale, 1.0))[use]))
    share = min(max(share, 1.0 / max(cells, FEWEST_CELLS)), 1.0 / FEWEST_CELLS)
    error: Floats = np.sqrt(light * (fixed + spread * share))
    return error


def _by_row(photo: Photo, realised: Factors) -> Factors:
    """A realised matrix with each row over its own weight."""
    own = cell_weights_s(photo, realised, by_row=True)
    return replace(realised, left=realised.left / own, coaxial=realised.coaxial / own)


def _straight(wanted: Wanted) -> Floats:
    """Light straight back over the light of the photo, (N,), if that were all of it: as much where
    none of it is wanted, or more than all."""
    share = wanted.diagonal()
    least = LEAST_STRAIGHT * share.max(initial=0.0)
    return 1.0 / np.where(share > 0.0, np.clip(share, least, 1.0), 1.0)


def _light(image: Floats) -> Floats:
    """Mean square light of the eight cells around each, (rows, cols, C)."""
    light = np.empty_like(image)
    for channel in range(light.shape[-1]):
        light[..., channel] = scipy.ndimage.convolve(image[..., channel] ** 2, RING, mode="nearest")
    return light


def _around(image: Floats, white: Floats | None) -> Floats:
    """What the cells around lead one to expect, (rows, cols): of shares of `white` where that is
    lit."""
    expected: Floats = scipy.ndimage.convolve(image, RING, mode="nearest")
    if white is not None:
        lit = white > DARK * white.max()
        shares = np.divide(image, white, out=np.zeros_like(image), where=lit)
        expected[lit] = (white * scipy.ndimage.convolve(shares, RING, mode="nearest"))[lit]
    return expected


def beside_weight(
    photo: Photo, shots: Mapping[str, Shown], grid: tuple[int, int], normalise: NormaliseName
) -> float:
    """How much light from one of the cells around is worth in the error of a photo that cannot tell
    it from direct light: what is lacking of all eight, and what is there of the cell's own, whose
    size nobody knows. 0 where that is the chance of codes, and of photos that do not want all other
    cells alike.

    Under quarter windows the projector's code cell reaches a quarter of a cell beyond the window
    that it belongs to. So a photo of indirect light lacks some of what comes from the cells around,
    and has some of what wandered within its own. All parts of a photo do so alike: their spread
    does not show it. How much light there is of either kind is modelled: by what a pilot tells
    (`pdcd.codes.pilot.scene_light`), else as a share of all light.
    """
    if photo.wanted.uniform is None or photo.wanted.uniform[0] == photo.wanted.uniform[1]:
        return 0.0
    diagonal, off = photo.wanted.uniform
    weights = weigh_cells(photo, shots, normalise)
    realised, cells_s = weights.realised, weights.cells_s
    lacking = sum(
        off - share for share in beside(realised.left, realised.right, cells_s, grid).values()
    )
    own = float(np.mean(realised.row_sums_s[1] / cells_s)) - diagonal
    weight = float(np.hypot(lacking, own))
    return 0.0 if weight < LEAST_BESIDE else weight


def beside_error(weight: float, near: Floats, grid: tuple[int, int]) -> Floats:
    """Standard deviation, (rows, cols, C), of the cells of a photo of that `beside_weight`; `near`
    is the light that each gets from one of those around, (N, C)."""
    return UNEVEN * weight * near.reshape(*grid, -1)


def usual_near_light(light: Floats) -> Floats:
    """Light that each cell gets from one of those around, (N, C), where no pilot tells; `light` is
    that of the photo."""
    return USUAL * np.maximum(light, 0.0)
