"""How much light a cell gets from the cells right beside it, by the photos of a pilot.

Windows that open parts of cells cannot tell such light from direct light, so that a photo through
them lacks some of it. From photo to photo of a pilot another choice of the cells around is lit:
what of a cell's light goes along with them came from there.
"""

from __future__ import annotations

import numpy as np
import scipy

from pdcd.codes.pilot.signs import Bools, Floats, signs

REACH = 3
"""Cells around that are taken to send light, less with the square of their distance. Without those
further off, which codes of a few photos light just when the nearest are dark, half of the light of
smooth scenes would not be found."""
AROUND = 5
"""Side, in cells, of the square over which a share is told: a few photos say little of one cell."""


def near_light(codes: Bools, photos: Floats, grid: tuple[int, int]) -> Floats:
    """Light that each cell gets from one of the eight around it, on average, (N, C) float64, >= 0,
    in the unit of the photos.

    It is the root of what its square is likely to be, so that chance, as sharp paths from afar
    bring it in, adds nothing on average.

    Parameters
    ----------
    codes : (K, N) bool, what was lit in the photos of a pilot.
    photos : (K, N, C) float64, without the light of paths that are known.
    """
    own = signs(codes)
    own -= own.mean(axis=0)
    around = _spread(own, grid)
    power = np.sum(own**2, axis=0)
    safe = np.where(power > 0.0, power, 1.0)
    # A cell's own code tells of its direct light; what of it is in those around tells nothing.
    around -= own * (np.sum(own * around, axis=0) / safe)
    told = _sums(np.sum(around**2, axis=0), grid)
    found = np.zeros(photos.shape[1:])
    if not told.any():
        return found
    for channel in range(photos.shape[2]):
        light = 2.0 * (photos[..., channel] - photos[..., channel].mean(axis=0))
        along = np.sum(around * light, axis=0)
        # Products of two cells: those of one with itself are chance as well.
        pairs = _sums(along, grid) ** 2 - _sums(along**2, grid)
        square = np.divide(pairs, told**2, out=np.zeros(grid), where=told > 0.0)
        likely = scipy.ndimage.uniform_filter(square, AROUND, mode="nearest")
        found[:, channel] = np.sqrt(np.maximum(likely, 0.0)).ravel()
    return found


def _spread(values: Floats, grid: tuple[int, int]) -> Floats:
    """Sums over the cells around each, (K, N), those beside it counting 1 on average."""
    down, right = np.mgrid[-REACH : REACH + 1, -REACH : REACH + 1]
    kernel = 1.0 / (1.0 + down**2 + right**2)
    kernel[REACH, REACH] = 0.0
    beside = kernel[REACH - 1 : REACH + 2, REACH - 1 : REACH + 2]
    kernel *= 8.0 / beside.sum()
    images = [
        scipy.ndimage.convolve(one.reshape(grid), kernel, mode="constant").ravel() for one in values
    ]
    return np.stack(images)


def _sums(values: Floats, grid: tuple[int, int]) -> Floats:
    """Sums of values of cells (N,) over the square around each, (rows, cols)."""
    mean = scipy.ndimage.uniform_filter(values.reshape(grid), AROUND, mode="constant")
    return np.asarray(mean * AROUND**2)
