"""What an indirect image itself tells of its error: light that spreads smoothly.

The image says how much indirect light each cell n gets, S_n. Where light spreads diffusely its
paths are much as ``x_n k(d) x_m``: two cells exchange light by what each of them exchanges with
all others and by their distance d. The realised probing matrix is known, hence also what it gets
wrong of such paths. This is taken off again: a control variate that costs no photo.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

Floats = NDArray[np.float64]

REACH = 8.0
"""Cells over which the model's light falls to one half: between a wax (2) and milk (no end)."""
SHARE = 0.5
"""Share of the image that is taken to be smooth. Half of it wins on most scenes at any number of
codes, and where all light is sharp or near it costs little."""
ROUNDS = 8
"""Steps of the scaling that makes the model's row sums the image; each leaves half the error."""
CHUNK = 2**22
"""Numbers transformed at once."""


def smooth_correction(
    left: Floats, right: Floats, weight: float, image: Floats, grid: tuple[int, int]
) -> Floats:
    """Return what to add to an indirect image for its smooth light: (N,) float64, in its unit.

    Parameters
    ----------
    left, right : (R, N) float64
        Factors of the realised probing matrix, ``A = left.T @ right`` (`pdcd.realised.Factors`).
    weight : float
        Weight the image was divided by, in the unit of A.
    image : (N,) float64
        The indirect image, row-major. Where sharp paths are known (`pdcd.pilot`), what is left of
        it without their light, their row sums.
    grid : (rows, cols)
        Cells of the scene, N in all.
    """
    spread = _Spread(grid)
    light = np.maximum(image, 0.0)
    part = np.sqrt(light / max(float(spread(np.ones_like(light)).max()), np.finfo(float).tiny))
    for _ in range(ROUNDS):
        arriving = spread(part)
        seen = np.divide(light, arriving, out=np.zeros_like(light), where=arriving > 0.0)
        part = np.sqrt(part * seen)
    realised = np.zeros_like(light)
    step = max(1, CHUNK // (4 * light.size))
    for start in range(0, left.shape[0], step):
        chunk = slice(start, start + step)
        realised += np.einsum("rn,rn->n", left[chunk], spread(right[chunk] * part))
    missing: Floats = SHARE * part * (spread(part) - realised / weight)
    return missing


class _Spread:
    """Sum over all other cells by 1 / (1 + d / REACH), as a product of Fourier transforms."""

    def __init__(self, grid: tuple[int, int]) -> None:
        self._grid = grid
        self._shape = tuple(scipy.fft.next_fast_len(2 * size - 1, real=True) for size in grid)
        row, col = (
            np.minimum(np.arange(size), size - np.arange(size)).astype(np.float64)
            for size in self._shape
        )
        kernel = 1.0 / (1.0 + np.hypot(row[:, None], col) / REACH)
        kernel[0, 0] = 0.0
        self._kernel = scipy.fft.rfft2(kernel)

    def __call__(self, light: Floats) -> Floats:
        """Spread images (..., N) over their cells, none to itself."""
        rows, cols = self._grid
        images = light.reshape(*light.shape[:-1], rows, cols)
        waves = scipy.fft.rfft2(images, s=self._shape) * self._kernel
        out = scipy.fft.irfft2(waves, s=self._shape)[..., :rows, :cols]
        spread: Floats = np.ascontiguousarray(out).reshape(light.shape)
        return spread
