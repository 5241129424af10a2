"""What the photos of a pilot tell of the light of each cell: that of single codes as random
projections of each row of the transport, and how much comes from the cells right beside it.
"""

from __future__ import annotations

import numpy as np
import scipy

from pdcd.arrays import Bools, Floats
from pdcd.errors import ConfigError


def to_signs(codes: Bools) -> Floats:
    """+1 where a cell is lit, -1 where it is dark."""
    found: Floats = np.where(codes, 1.0, -1.0)
    return found


def compute_projections(photos: Floats) -> Floats:
    """``T h_k`` (K0, N): the mean photo is ``T 1 / 2``, as every cell is lit half of the time."""
    found: Floats = 2.0 * (photos - photos.mean(axis=0))
    return found


def estimate_direct_light(codes: Bools, photos: Floats) -> Floats:
    """Estimate the direct image (N,) from balanced signs: the mean of ``h_k (T h_k)``."""
    estimate: Floats = np.mean(to_signs(codes) * compute_projections(photos), axis=0)
    return estimate


def check_photos(codes: Bools, photos: Floats, cells: int) -> None:
    """Raise ConfigError unless there is a photo of all cells for each code, lit half of the
    time."""
    if codes.ndim != 2 or codes.shape != photos.shape or codes.shape[1] != cells:
        raise ConfigError(
            f"pilot codes {codes.shape} and photos {photos.shape} do not fit {cells} cells",
            hint="give one photo of all cells for each code",
        )
    if np.any(2 * np.count_nonzero(codes, axis=0) != codes.shape[0]):
        raise ConfigError(
            "a cell is not lit in half of the pilot codes",
            hint="use the codes of `make_pilot_codes`",
        )


_REACH = 3
"""Cells around that are taken to send light, less with the square of their distance. Without those
further off, which codes of a few photos light just when the nearest are dark, half of the light of
smooth scenes would not be found."""
_NEAR_AROUND = 5
"""Side, in cells, of the square over which a share is told: a few photos say little of one cell."""


def estimate_adjacent_light(codes: Bools, photos: Floats, grid: tuple[int, int]) -> Floats:
    """Light that each cell gets from one of the eight around it, on average, (N, C) float64, >= 0,
    in the unit of the photos.

    It is the root of what its square is likely to be, so that chance, as sharp paths from afar
    bring it in, adds nothing on average.

    Parameters
    ----------
    codes : (K, N) bool, what was lit in the photos of a pilot.
    photos : (K, N, C) float64, without the light of paths that are known.
    """
    own = to_signs(codes)
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
        likely = scipy.ndimage.uniform_filter(square, _NEAR_AROUND, mode="nearest")
        found[:, channel] = np.sqrt(np.maximum(likely, 0.0)).ravel()
    return found


def _spread(values: Floats, grid: tuple[int, int]) -> Floats:
    """Sums over the cells around each, (K, N), those beside it counting 1 on average."""
    down, right = np.mgrid[-_REACH : _REACH + 1, -_REACH : _REACH + 1]
    kernel = 1.0 / (1.0 + down**2 + right**2)
    kernel[_REACH, _REACH] = 0.0
    beside = kernel[_REACH - 1 : _REACH + 2, _REACH - 1 : _REACH + 2]
    kernel *= 8.0 / beside.sum()
    images = [
        scipy.ndimage.convolve(one.reshape(grid), kernel, mode="constant").ravel() for one in values
    ]
    return np.stack(images)


def _sums(values: Floats, grid: tuple[int, int]) -> Floats:
    """Sums of values of cells (N,) over the square around each, (rows, cols)."""
    mean = scipy.ndimage.uniform_filter(values.reshape(grid), _NEAR_AROUND, mode="constant")
    return np.asarray(mean * _NEAR_AROUND**2)
