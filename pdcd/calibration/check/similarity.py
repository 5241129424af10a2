"""How points moved between two looks: shift, turn and size, whatever single points do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROUNDS = 12
"""Reweighted solves."""
CAUCHY = 2.5
"""Scale of the weights, in standard deviations."""
PARTS = (3, 4)
"""Rows and columns of parts of the field in which what is left is averaged."""
FEWEST = 4
"""Points of a part that its average takes."""


@dataclass(frozen=True)
class Similarity:
    """A shift, a turn and a size: z -> centre + (1 + growth) (z - centre) + shift, in the plane of
    complex numbers, right and down.

    growth : its real part is a size, its imaginary part a turn in rad, clockwise.
    sigma : standard deviations of shift and of growth, in either direction.
    left : largest mean of what is left over the parts of the field: what no similarity explains.
    """

    centre: complex
    shift: complex
    growth: complex
    sigma: tuple[float, float]
    left: float

    def __call__(self, points: Floats) -> Floats:
        """Points (..., 2) as they were then -> as they are now."""
        z = points[..., 0] + 1j * points[..., 1]
        return _pairs(z + self.shift + self.growth * (z - self.centre))

    def back(self, points: Floats) -> Floats:
        """Points (..., 2) as they are now -> as they were then."""
        z = points[..., 0] + 1j * points[..., 1]
        return _pairs(self.centre + (z - self.centre - self.shift) / (1.0 + self.growth))

    def worst(self, corners: Floats) -> tuple[float, float]:
        """How far the corner (n, 2) that moved most has moved, and its standard deviation."""
        moved = np.hypot(*(self(corners) - corners).T)
        z = corners[:, 0] + 1j * corners[:, 1]
        place = int(np.argmax(moved))
        return float(moved[place]), float(
            np.hypot(self.sigma[0], self.sigma[1] * abs(z[place] - self.centre))
        )


def similarity(then: Floats, now: Floats, sigma: Floats) -> Similarity:
    """The similarity from points then to points now, (n, 2) each, least squares with Cauchy
    weights.

    sigma : (n,) of the points' differences; enlarged to what they really scatter.
    """
    z, w = then[:, 0] + 1j * then[:, 1], now[:, 0] + 1j * now[:, 1]
    centre = complex(z.mean())
    near, moved = z - centre, w - z
    at_start = complex(np.median(moved.real), np.median(moved.imag))
    shift, growth = at_start, 0j
    for _ in range(ROUNDS):
        left = np.abs(moved - shift - growth * near) / sigma
        # Of a distance in the plane the median is 1.18 standard deviations of either direction.
        scale = max(1.0, float(np.median(left)) / 1.1774)
        weight = 1.0 / (sigma**2 * (1.0 + (left / (CAUCHY * scale)) ** 2))
        rows = np.stack([np.ones(z.size, dtype=np.complex128), near], axis=-1)
        square = rows.conj().T @ (weight[:, None] * rows)
        solved = np.linalg.solve(square, rows.conj().T @ (weight * moved))
        shift, growth = complex(solved[0]), complex(solved[1])
    # Downweighted points count for less than their number: 1.3 is what Cauchy costs.
    spread = 1.3 * scale * np.sqrt(np.diagonal(np.linalg.inv(square)).real)
    rest = moved - shift - growth * near
    errors = (float(spread[0]), float(spread[1]))
    return Similarity(centre, shift, growth, errors, _unexplained(then, _pairs(rest)))


def _unexplained(points: Floats, left: Floats) -> float:
    """The largest median of what is left (n, 2), over parts of the field."""
    rows, cols = PARTS
    low, size = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-9)
    cell = np.minimum(((points - low) / size * (cols, rows)).astype(np.int64), (cols - 1, rows - 1))
    number = cell[:, 1] * cols + cell[:, 0]
    largest = 0.0
    for part in range(rows * cols):
        inside = left[number == part]
        if len(inside) >= FEWEST:
            largest = max(largest, float(np.hypot(*np.median(inside, axis=0))))
    return largest


def _pairs(z: NDArray[np.complex128]) -> Floats:
    return np.stack([z.real, z.imag], axis=-1)
