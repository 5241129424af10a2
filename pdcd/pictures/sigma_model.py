"""The error of the codes of a single photo, predicted: what nobody measured must be assumed.

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

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.pictures.combine import Picture, cell_weights_s, realised_photo, sigma_of
from pdcd.pictures.exposed import Exposed
from pdcd.pictures.quads import of_cells, shared_out
from pdcd.pictures.sigma import Barred, barred
from pdcd.probing.deviation import row_deviations, weight_s
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import Wanted
from pdcd.recipes.recipe import Photo, Recipe
from pdcd.sensor.cells import CellMap

Floats = NDArray[np.float64]

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


def modelled(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    photos: Mapping[str, Picture],
    pictures: Mapping[str, Picture],
    cells: CellMap,
    alive: Callable[[], None] = lambda: None,
    sharp: Floats | None = None,
    *,
    near: Mapping[str, Floats] = NONE,
) -> dict[str, Barred]:
    """The pictures of a recipe, with sensor noise so far, and the code error by the model above.

    It is worked out on the means of cells, as what varies between the quads of a cell is texture,
    and then lies on the quads as light does.

    `photos` are the scaled ones that the pictures were made of
    (`pdcd.pictures.combine.scaled_photos`). Code errors of different photos are taken as
    independent. `alive` is called now and then, may raise. `sharp` (N, C) is what the first photos
    of a pilot tell of the sharp paths of each cell (`pdcd.codes.pilot.scene_light`): of photos in
    which paths are corrected it takes the place of N_eff. `near` are errors of photos by light from
    right beside each cell (`pdcd.pictures.beside`). Photos of far light, whose cells are each
    divided by their own weight, are judged by these weights and by the roughness of all their
    light. The light straight back is what the photo shows over the share of it that was wanted.
    """
    coarse = {name: of_cells(photo, cells) for name, photo in photos.items()}
    white = coarse["white"].image if "white" in coarse else None
    alone = {}
    for photo in recipe.photos:
        picture = coarse[photo.name]
        realised = realised_photo(photo.shots, shots)
        far = photo.beyond > 0
        weight = weight_s(realised, photo.wanted)
        if far:
            realised, weight = _by_row(photo, realised), 1.0
        rows = row_deviations(realised, photo.wanted, weight, alive)
        mean, variance, diagonal = (row.reshape(*cells.grid, 1) for row in rows)
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
        alone[photo.name] = shared_out(error, photos[photo.name], picture, cells)
    return {
        name: barred(p, sigma_of(recipe.pictures[name], photos, alone), "modelled")
        for name, p in pictures.items()
    }


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
