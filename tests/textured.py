"""Light with the detail of a texture, as a camera of any resolution would see it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from pdcd.virtual.scene.texture import average_cells, sample_texture

Array = NDArray[np.float64]


def detailed(cells: Array, grid: tuple[int, int], texture: Array, points: Array) -> Array:
    """What cells (N, 3) send with the detail of a texture (H, W, 3), at points (..., 2) of the
    field: (..., 3)."""
    smooth = sample_cells(cells / average_cells(texture, grid), grid, points)
    return np.asarray(sample_texture(texture, points) * smooth)


def sample_cells(cells: Array, grid: tuple[int, int], points: Array) -> Array:
    """Values of cells (N, C) at points of the field (..., 2), (..., C): linear between the centres
    of cells, and beyond those of the outermost ones they go on."""
    rows, cols = grid
    place = np.stack([points[..., 1] * rows, points[..., 0] * cols]) - 0.5
    images = cells.reshape(rows, cols, -1)
    return np.stack(
        [map_coordinates(i, place, order=1, mode="nearest") for i in np.moveaxis(images, 2, 0)], -1
    )
