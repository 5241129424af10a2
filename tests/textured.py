"""Light with the detail of a texture, as a camera of any resolution would see it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.virtual.scene.texture import average_cells, sample_cells, sample_texture

Array = NDArray[np.float64]


def detailed(cells: Array, grid: tuple[int, int], texture: Array, points: Array) -> Array:
    """What cells (N, 3) send with the detail of a texture (H, W, 3), at points (..., 2) of the
    field: (..., 3)."""
    smooth = sample_cells(cells / average_cells(texture, grid), grid, points)
    return np.asarray(sample_texture(texture, points) * smooth)
