"""Homographies from the field of one device to that of another, as off-axis benches have them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SINGULAR = 1e-9
"""Determinant over the cube of the largest entry below which there is no inverse."""
HORIZON = 1e-6
"""The same of the depth of a point."""


def through(matrix: tuple[float, ...], points: Floats) -> Floats:
    """Points (n, 2) of one field, 0 to 1 across and down, on the other: (n, 2).

    matrix : nine numbers, row by row, for (x, y, 1).

    Raises ValueError, in words for a user, for one that has no inverse or that takes any of the
    points to infinity or behind it.
    """
    homography = np.array(matrix, dtype=np.float64).reshape(3, 3)
    scale = float(np.abs(homography).max())
    if not np.isfinite(scale) or scale == 0.0 or abs(np.linalg.det(homography / scale)) < SINGULAR:
        raise ValueError("the homography has no inverse")
    places = np.column_stack([points, np.ones(len(points))]) @ homography.T
    depth = places[:, 2] / scale
    if not (np.all(depth > HORIZON) or np.all(depth < -HORIZON)):
        raise ValueError("the homography takes a part of the field to infinity")
    found: Floats = places[:, :2] / places[:, 2:]
    return found
