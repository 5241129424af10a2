"""Transport that depends on the distance travelled: a kernel, such as light inside wax.

``T_nm = out_n k(n - m) in_m``. Light that leaves the grid is lost: borders are closed, nothing
wraps around. Two routes give the same numbers. A kernel whose image has a low rank (a Gaussian
has rank 1) is applied along the columns and then along the rows by two small matrix products;
any other kernel goes through a zero-padded Fourier transform.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.virtual.scene.effects import Array, Cells, TintedEffect, sum_products

FFT_COST = 2000
"""Cost of the Fourier route, in multiplications a cell of the separable route (measured)."""


@dataclass(frozen=True, eq=False)
class KernelEffect(TintedEffect):
    """Transport by distance.

    grid : (rows, cols)
    kernel : (2a+1, 2b+1) float64
        Weight of each offset (row, column) of n from m; the centre is offset zero. Offsets that
        are not covered carry no light.
    out, into : (N,) float64
        Share of the light that gets out at a cell and into a cell.
    """

    grid: tuple[int, int]
    kernel: Array
    out: Array
    into: Array

    @cached_property
    def _factors(self) -> tuple[tuple[Array, Array], ...]:
        """Pairs of (rows, rows) and (cols, cols) matrices whose products sum to the kernel;
        empty when the Fourier route is cheaper."""
        left, values, right = np.linalg.svd(self.kernel)
        # Terms at the rounding of the largest one are noise of the decomposition itself.
        rank = max(1, int(np.sum(values > values[0] * 1e-15)))
        if rank * sum(self.grid) > FFT_COST:
            return ()
        return tuple(
            (
                _toeplitz(left[:, j] * values[j], self.grid[0]),
                _toeplitz(right[j], self.grid[1]),
            )
            for j in range(rank)
        )

    @cached_property
    def _spectrum(self) -> NDArray[np.complex128]:
        """Fourier transform of the kernel at the padded size."""
        spectrum: NDArray[np.complex128] = scipy.fft.rfft2(self.kernel, s=self._padded)
        return spectrum

    @cached_property
    def _padded(self) -> tuple[int, int]:
        """Size at which a circular convolution no longer wraps onto the grid."""
        sizes = [g + k - 1 for g, k in zip(self.grid, self.kernel.shape, strict=True)]
        return (scipy.fft.next_fast_len(sizes[0], True), scipy.fft.next_fast_len(sizes[1], True))

    def _spread(self, images: Array) -> Array:
        """Convolve each of `images` (B, rows, cols) with the kernel."""
        if self._factors:
            terms = [down @ (images @ across.T) for down, across in self._factors]
            return np.sum(terms, axis=0) if len(terms) > 1 else terms[0]
        rows, cols = self.grid
        first, second = self.kernel.shape[0] // 2, self.kernel.shape[1] // 2
        product = scipy.fft.rfft2(images, s=self._padded) * self._spectrum
        whole: Array = scipy.fft.irfft2(product, s=self._padded)
        return whole[:, first : first + rows, second : second + cols]

    def apply(self, light: Array) -> Array:
        """See `Effect.apply`."""
        images = (light * self.into).reshape(-1, *self.grid)
        return self._spread(images).reshape(light.shape) * self.out

    def probe(self, left: Array, right: Array) -> Array:
        """See `Effect.probe`."""
        return sum_products(left, self.apply(right))

    def diagonal(self) -> Array:
        """See `Effect.diagonal`."""
        centre: float = self.kernel[self.kernel.shape[0] // 2, self.kernel.shape[1] // 2]
        return self.out * self.into * centre

    def entries(self, seen: Cells, lit: Cells) -> Array:
        """See `Effect.entries`."""
        (to_y, to_x), (from_y, from_x) = (np.divmod(n, self.grid[1]) for n in (seen, lit))
        down = to_y - from_y + self.kernel.shape[0] // 2
        across = to_x - from_x + self.kernel.shape[1] // 2
        inside = (down >= 0) & (down < self.kernel.shape[0])
        inside &= (across >= 0) & (across < self.kernel.shape[1])
        weights = self.kernel[np.where(inside, down, 0), np.where(inside, across, 0)]
        return np.asarray(self.out[seen] * np.where(inside, weights, 0.0) * self.into[lit])

    def dense(self) -> Array:
        """See `Effect.dense`."""
        cells = np.arange(self.out.size)
        return self.entries(cells[:, None], cells[None, :])


def make_gaussian_kernel(grid: tuple[int, int], pitch: tuple[float, float], sigma: float) -> Array:
    """Return a Gaussian kernel (2 rows - 1, 2 cols - 1) that passes on all light, or less.

    Parameters
    ----------
    grid : (rows, cols)
    pitch : (row, column) distance between cells
    sigma : standard deviation, in the same unit

    Notes
    -----
    The weights are samples divided by the sum over the whole plane, so the part that lies beyond
    the kernel is lost as light that leaves the scene.
    """
    return np.outer(*(_gaussian_line(n, p, sigma) for n, p in zip(grid, pitch, strict=True)))


def _gaussian_line(cells: int, pitch: float, sigma: float) -> Array:
    reach = max(cells - 1, int(np.ceil(9 * sigma / pitch)))
    # Nine standard deviations hold the whole sum to rounding.
    offsets = pitch * np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (offsets / sigma) ** 2)
    kept: Array = (weights / weights.sum())[reach - cells + 1 : reach + cells]
    return kept


def _toeplitz(taps: Array, cells: int) -> Array:
    """Return the (cells, cells) matrix that convolves a line with `taps` (2a+1,), closed ends."""
    index = np.arange(cells)
    offset = index[:, None] - index[None, :] + taps.size // 2
    inside = (offset >= 0) & (offset < taps.size)
    matrix: Array = np.where(inside, taps[np.where(inside, offset, 0)], 0.0)
    return matrix
