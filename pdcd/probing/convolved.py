"""A wanted matrix that depends only on the shift between two cells: a filter with many taps.

A filter with few taps can also be a sum of `pdcd.probing.wanted.MatchPart`. But a sum over pairs of
parts grows with their square, and a kernel over a whole grid has four times as many taps as there
are cells. Here all sums over shifts are convolutions, done by FFT: O(N log N) for each image.

The module also has wanted weights along epipolar lines: rows of cells of a rectified rig.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats, Indices
from pdcd.probing.wanted import Grid, MatrixPart, NearPart, sum_boxes

_IMAGES = 16
"""Images that are convolved together; bounds the memory."""


@dataclass(frozen=True, eq=False)
class KernelPart:
    """``taps[n - m]``, the difference counted in (rows, columns) from the centre of `taps`, an
    array with odd sides; 0 beyond it. `grid` is (rows, columns)."""

    grid: Grid
    taps: Floats

    def rows(self, start: int, stop: int) -> Floats:
        """Rows start..stop-1."""
        n, m = np.arange(start, stop)[:, None], np.arange(self.grid[0] * self.grid[1])[None, :]
        return self._at(n, m)

    def others(self, images: Floats) -> Floats:
        """See `MatrixPart.others`."""
        own = self.taps[self._centre]
        return np.asarray(filter_images(images, self.taps, self.grid) - own * images)

    def entries(self, column: Indices) -> Floats:
        """See `MatrixPart.entries`."""
        found = self._at(np.arange(column.size), np.maximum(column, 0))
        return np.where(column >= 0, found, 0.0)

    def overlap(self, other: MatrixPart, weights: Floats) -> Floats:
        """See `MatrixPart.overlap`."""
        if isinstance(other, KernelPart):
            shared = self.taps * _cut(other.taps, self.taps.shape)
        elif isinstance(other, NearPart):
            side = 2 * other.radius + 1
            shared = self.taps * _cut(np.ones((side, side)), self.taps.shape)
        elif isinstance(other, SameRowPart):
            shared = np.zeros_like(self.taps)
            shared[self._centre[0]] = self.taps[self._centre[0]]
        else:
            return other.overlap(self, weights)
        return np.asarray(KernelPart(self.grid, shared).others(weights[None])[0])

    def product(self) -> None:
        """See `MatrixPart.product`: there is none."""

    @property
    def _centre(self) -> tuple[int, int]:
        return self.taps.shape[0] // 2, self.taps.shape[1] // 2

    def _at(self, n: Indices, m: Indices) -> Floats:
        """Entries of cells n and m, numbered row by row; arrays of shapes that broadcast."""
        up, left = self._centre
        down = n // self.grid[1] - m // self.grid[1] + up
        right = n % self.grid[1] - m % self.grid[1] + left
        height, width = self.taps.shape
        inside = (down >= 0) & (down < height) & (right >= 0) & (right < width)
        found = self.taps[np.clip(down, 0, height - 1), np.clip(right, 0, width - 1)]
        return np.where(inside, found, 0.0)


def filter_images(images: Floats, taps: Floats, shape: Grid) -> Floats:
    """``sum over m of taps[n - m] images_rm``, (R, L) float64, for images (R, L) over `shape`.

    `taps` has odd sides; its centre is the difference (0, 0). Nothing lies beyond the border.
    """
    # A tenth of what a daemon loads; it only plans, and convolves nothing.
    import scipy.fft

    up, left = taps.shape[0] // 2, taps.shape[1] // 2
    full = tuple(
        scipy.fft.next_fast_len(side + tap - 1, real=True)
        for side, tap in zip(shape, taps.shape, strict=True)
    )
    spectrum = scipy.fft.rfft2(taps, full)
    out = np.empty(images.shape)
    for start in range(0, len(images), _IMAGES):
        some = images[start : start + _IMAGES].reshape(-1, *shape)
        whole = scipy.fft.irfft2(scipy.fft.rfft2(some, full) * spectrum, full)
        inner = whole[:, up : up + shape[0], left : left + shape[1]]
        out[start : start + _IMAGES] = inner.reshape(len(some), -1)
    return out


def _cut(taps: NDArray[np.float64], shape: tuple[int, ...]) -> Floats:
    """Odd-sided taps cut or padded with 0 to another shape around the same centre."""
    out = np.zeros(shape)
    spans = []
    for have, want in zip(taps.shape, shape, strict=True):
        half = min(have, want) // 2
        spans.append((slice(want // 2 - half, want // 2 + half + 1),
                      slice(have // 2 - half, have // 2 + half + 1)))  # fmt: skip
    out[spans[0][0], spans[1][0]] = taps[spans[0][1], spans[1][1]]
    return out


@dataclass(frozen=True, eq=False)
class SameRowPart:
    """1 where camera cell and projector cell lie in one row, on one epipolar line."""

    grid: Grid

    def rows(self, start: int, stop: int) -> Floats:
        """See `MatrixPart.rows`."""
        row = np.arange(self.grid[0] * self.grid[1]) // self.grid[1]
        return np.asarray(row[start:stop, None] == row[None, :], dtype=np.float64)

    def others(self, images: Floats) -> Floats:
        """See `MatrixPart.others`."""
        lines = images.reshape(-1, *self.grid)
        return np.asarray((lines.sum(axis=2, keepdims=True) - lines).reshape(images.shape))

    def entries(self, column: Indices) -> Floats:
        """See `MatrixPart.entries`."""
        row = np.arange(column.size) // self.grid[1]
        return np.where((column >= 0) & (column // self.grid[1] == row), 1.0, 0.0)

    def overlap(self, other: MatrixPart, weights: Floats) -> Floats:
        """See `MatrixPart.overlap`."""
        if isinstance(other, SameRowPart):
            return np.asarray(self.others(weights[None])[0])
        if isinstance(other, NearPart):
            lines = sum_boxes(weights.reshape(self.grid), 1, other.radius)
            return np.asarray(lines.ravel() - weights)
        return other.overlap(self, weights)

    def product(self) -> None:
        """See `MatrixPart.product`: there is none."""
