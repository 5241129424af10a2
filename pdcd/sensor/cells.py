"""Which pixels of a camera's frame see which cell of the scene: the one place that knows it."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DecodeError

Floats = NDArray[np.float64]


class CellMap(msgspec.Struct, frozen=True, kw_only=True):
    """Cells as blocks of pixels: the frame is cut evenly into rows and columns of cells.

    grid : rows and columns of cells, N in all.
    frame : rows and columns of pixels (h, w), one for each Bayer quad; multiples of the grid's.

    Kept with every run, so that it is decoded with the map that it was taken with.
    """

    grid: tuple[int, int]
    frame: tuple[int, int]

    @classmethod
    def block(cls, grid: tuple[int, int], frame: tuple[int, int]) -> CellMap:
        """The map of a frame. Raises DecodeError when the grid does not divide it."""
        if frame[0] % grid[0] or frame[1] % grid[1] or not frame[0] * frame[1]:
            raise DecodeError(
                f"a frame of {frame[0]} x {frame[1]} pixels cannot be cut into {grid[0]} x "
                f"{grid[1]} cells",
                device="camera",
                hint="choose scene.grid so that its rows and columns divide those of the frame",
            )
        return cls(grid=grid, frame=frame)

    @property
    def pixels(self) -> int:
        """Pixels of a cell."""
        return self._block[0] * self._block[1]

    def spread(self, cells: NDArray[Any]) -> NDArray[Any]:
        """Values of cells, (N, ...) -> of pixels, (h, w, ...)."""
        down, right = self._block
        table = cells.reshape(*self.grid, *cells.shape[1:])
        return table.repeat(down, axis=0).repeat(right, axis=1)

    def mean(self, image: Floats) -> Floats:
        """Values of pixels (h, w, C) -> their mean over each cell, (N, C)."""
        (rows, cols), (down, right) = self.grid, self._block
        blocks = image.reshape(rows, down, cols, right, image.shape[2])
        means: Floats = blocks.mean(axis=(1, 3)).reshape(rows * cols, -1)
        return means

    @property
    def _block(self) -> tuple[int, int]:
        return self.frame[0] // self.grid[0], self.frame[1] // self.grid[1]
