"""Detail of a scene that is finer than its cells.

A texture is an image (H, W, C) that is spread evenly over the field, of any size and of any
positive numbers: pixel (k, l) covers l / W to (l + 1) / W across and k / H to (k + 1) / H down, and
has one value all over. Cells hold only means; the light that the scene sends from a point y is

    texture(y) * between(cells / means)(y)

with `means` those of the texture over the cells, and cells / means linear between cell centres.
Where light follows the texture, as it does on a matte surface, cells / means is smooth, and cell
edges do not show. Only the proportions of a texture count: any factor cancels.

Points of the field are (x, y), 0 to 1 to the right and down.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.virtual.scene.effects import Array

Drawing = Callable[[], Array]
"""Draws a texture; a function of a module, or a partial of one, so that a scene can be pickled."""


def average_cells(texture: Array, grid: tuple[int, int]) -> Array:
    """Return the means (N, C) of a texture (H, W, C) over the cells of a grid (rows, cols).

    A pixel that lies in several cells counts in each by its share.
    """
    height, width, channels = texture.shape
    down = compute_pixel_shares(grid[0], height) @ texture.reshape(height, -1)
    across = down.reshape(grid[0], width, channels).transpose(1, 0, 2).reshape(width, -1)
    means = (compute_pixel_shares(grid[1], width) @ across).reshape(grid[1], grid[0], channels)
    whole: Array = np.ascontiguousarray(means.transpose(1, 0, 2))
    return whole.reshape(grid[0] * grid[1], channels)


def sample_texture(texture: Array, points: Array) -> Array:
    """Return a texture (H, W, C) at points of the field (..., 2): (..., C).

    Beyond the field its border goes on; a point that is NaN gets the first pixel.
    """
    height, width, _ = texture.shape
    x, y = (_whole(points[..., axis], size) for axis, size in enumerate((width, height)))
    y *= width
    y += x
    found: Array = texture.reshape(height * width, -1).take(y, axis=0, mode="clip")
    return found


def _whole(places: Array, size: int) -> NDArray[np.int32]:
    """Pixels that places on a line of the field lie in, of so many; the first for NaN."""
    found = places * size
    np.clip(found, 0.0, size - 1, out=found)
    found[np.isnan(found)] = 0.0
    return found.astype(np.int32)


def compute_pixel_shares(cells: int, pixels: int) -> scipy.sparse.csr_array:
    """Return how much each pixel of a line takes part in the mean of each cell, (cells, pixels).

    Both divide the same line evenly; rows sum to 1.
    """
    edges = np.unique(
        np.concatenate([np.arange(cells + 1) * pixels, np.arange(pixels + 1) * cells])
    )  # of cells and pixels, in parts of which both are whole numbers
    middle = (edges[1:] + edges[:-1]) / 2.0
    place = ((middle / pixels).astype(np.intp), (middle / cells).astype(np.intp))
    return scipy.sparse.csr_array((np.diff(edges) / pixels, place), shape=(cells, pixels))
