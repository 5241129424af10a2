"""Drawing of preset scenes: shapes on a raster, a few points a cell or the pixels of a projector.

All presets are drawn in one frame, whatever their grid: x from -4/3 (left) to 4/3, y from -1
(top) to 1. The same drawing serves twice: averaged over cells it is what light transport is made
of, and on the `detail` raster it is the texture. A colour image is (rows, cols, 3) of the raster, a
shape is a boolean (rows, cols).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.virtual.scene.effects import Array

Shape = NDArray[np.bool_]

FRAME_WIDTH = 8.0 / 3.0
FRAME_HEIGHT = 2.0
_FINE = 5
"""Raster points a cell, along either axis."""


class FrameRaster:
    """Points over the frame, and shapes on them.

    Attributes
    ----------
    x, y : (rows, cols) float64
        Places of the points.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.x, self.y = _places(shape)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of points."""
        return (self.x.shape[0], self.x.shape[1])

    def part(self, rows: slice, cols: slice) -> FrameRaster:
        """Return some of the points, where a small thing is drawn: all others cost nothing."""
        fewer = FrameRaster.__new__(FrameRaster)
        fewer.x, fewer.y = self.x[rows, cols], self.y[rows, cols]
        return fewer

    def fill(self, colour: Sequence[float]) -> Array:
        """Return an image of one colour (3,)."""
        image: Array = np.ones((*self.x.shape, 1)) * np.asarray(colour, dtype=np.float64)
        return image

    def disk(self, x: float, y: float, radius: float) -> Shape:
        """Return a disk."""
        inside: Shape = np.hypot(self.x - x, self.y - y) <= radius
        return inside

    def box(self, left: float, top: float, right: float, bottom: float) -> Shape:
        """Return an upright rectangle."""
        inside: Shape = (self.x >= left) & (self.x < right) & (self.y >= top) & (self.y < bottom)
        return inside

    def polygon(self, corners: Sequence[tuple[float, float]]) -> Shape:
        """Return the inside (even-odd rule) of a polygon of (x, y) corners."""
        inside = np.zeros(self.x.shape, dtype=np.bool_)
        for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
            if y0 == y1:
                continue  # a level edge is never crossed by a level line
            crosses = (self.y >= y0) != (self.y >= y1)
            inside ^= crosses & (self.x < x0 + (self.y - y0) * (x1 - x0) / (y1 - y0))
        return inside


class Canvas(FrameRaster):
    """The raster of a grid, `_FINE` points a cell along either axis.

    Attributes
    ----------
    grid : (rows, cols)
    pitch : (row, column) size of a cell in the frame
    cell_x, cell_y : (rows, cols) float64
        Places of the cell centres.
    """

    def __init__(self, grid: tuple[int, int]) -> None:
        super().__init__((_FINE * grid[0], _FINE * grid[1]))
        self.grid = grid
        self.pitch = (FRAME_HEIGHT / grid[0], FRAME_WIDTH / grid[1])
        self.cell_x, self.cell_y = _places(grid)

    def cells(self, image: NDArray[Any]) -> Array:
        """Average an image or a shape over cells: (N, 3) or (N,) float64."""
        rows, cols = self.grid
        parts = image.reshape(rows, _FINE, cols, _FINE, -1).mean(axis=(1, 3), dtype=np.float64)
        averaged: Array = parts.reshape(rows * cols, *image.shape[2:])
        return averaged

    def links(self, shape: Shape, x: Array, y: Array) -> Any:
        """Return where light goes that falls on `shape`: CSR (N to, N from) of shares.

        `x`, `y` (fine rows, fine cols) are the places where the light of each raster point
        arrives; light that leaves the frame is lost, so columns sum to at most 1.
        """
        column = np.floor((x[shape] / FRAME_WIDTH + 0.5) * self.grid[1]).astype(np.intp)
        row = np.floor((y[shape] / FRAME_HEIGHT + 0.5) * self.grid[0]).astype(np.intp)
        hit = (column >= 0) & (column < self.grid[1]) & (row >= 0) & (row < self.grid[0])
        numbers = np.arange(self.grid[0] * self.grid[1]).reshape(self.grid)
        source = numbers.repeat(_FINE, axis=0).repeat(_FINE, axis=1)[shape]
        target = (row * self.grid[1] + column)[hit]
        share = np.full(target.size, 1.0 / _FINE**2)
        links = scipy.sparse.coo_array(
            (share, (target, source[hit])), shape=(numbers.size, numbers.size)
        )
        return links.tocsr()


def _places(grid: tuple[int, int]) -> tuple[Array, Array]:
    x = FRAME_WIDTH * ((np.arange(grid[1]) + 0.5) / grid[1] - 0.5)
    y = FRAME_HEIGHT * ((np.arange(grid[0]) + 0.5) / grid[0] - 0.5)
    across, down = np.meshgrid(x, y)
    return across, down


def read_seed(kind: str, options: Mapping[str, Any]) -> int:
    """Return the only option of a preset, `seed` (0 when left out): it sets what chance decides.

    Raises
    ------
    ConfigError
        For any other option, or a seed that is not a whole number from 0 on.
    """
    unknown = sorted(set(options) - {"seed"})
    if unknown:
        raise ConfigError(
            f"[scene] options: {kind!r} does not know {', '.join(unknown)}",
            hint="its only option is `seed`",
        )
    seed = options.get("seed", 0)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ConfigError(
            f"[scene] options: seed is {seed!r}", hint="give a whole number from 0 on"
        )
    return seed
