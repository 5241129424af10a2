"""How strong the sharp light of each cell is, by the first photos of a pilot."""

from __future__ import annotations

import numpy as np
import scipy

from pdcd.codes.pilot.signs import Bools, Floats, check_photos, direct_light, projections, signs

AROUND = 3
"""Side, in cells, of the square over which squares are averaged: four photos say little of one
cell."""


def sharp_squares(
    codes: Bools, photos: Floats, grid: tuple[int, int], *, sigma: Floats, paths: Floats
) -> Floats:
    """Sum of the squares of each cell's sharp paths, (N, C), >= 0, beside those that are known.

    The sum over a row that `pdcd.codes.pilot.links.sharpness` takes the mean of. Smooth light makes
    the photos alike, and does not count.

    Parameters
    ----------
    codes : (K0, N) bool, the `SCOUTS` first of `pilot_codes`.
    photos, sigma : (K0, N, C) float64, photos of single codes and their noise, in scene units.
    paths : (K0, N, C) float64
        Light of the paths known in these photos.

    Raises
    ------
    ConfigError
        The arrays do not fit each other, or a cell is not lit in half of the codes.
    """
    count, cells = codes.shape
    found = np.empty((cells, photos.shape[2]))
    for channel in range(photos.shape[2]):
        series = photos[..., channel] - paths[..., channel]
        check_photos(codes, series, cells)
        rest = projections(series) - signs(codes) * direct_light(codes, series)
        noise = 4.0 * np.mean(sigma[..., channel] ** 2, axis=0)
        # The mean photo and the direct light take a dimension each; of all other light the share
        # 1 / (count - 1) went into the direct light.
        square = np.sum(rest**2, axis=0) / (count - 2) - noise
        around = scipy.ndimage.uniform_filter(square.reshape(grid), AROUND, mode="nearest")
        found[:, channel] = (count - 1) / count * np.maximum(around, 0.0).ravel()
    return found
