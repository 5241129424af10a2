"""How points moved as a whole: shift, turn and growth, robust against single points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from pdcd.arrays import Floats

_PARTS = (3, 4)
"""Rows and columns of parts of the picture for which residuals are given."""
_FEWEST = 4
"""Points that a part needs for a residual."""
_CAUCHY = 2.5
"""Error in standard deviations beyond which a point counts less."""
_TO_SIGMA = 1.4826
"""From the median of absolute deviations to a standard deviation."""


@dataclass(frozen=True, eq=False)
class MapDrift:
    """How points moved from where maps have them to where they are, in pixels about a picture's
    middle.

    size_px : (width, height). numbers : (4,) shift to the right and down, growth, and turn in rad,
        clockwise. sigma : (4,). left : (rows, cols, 2) median residual in each part of the picture,
        0 where there are few points. count : number of points.
    """

    size_px: tuple[int, int]
    numbers: Floats
    sigma: Floats
    left: Floats
    count: int

    @classmethod
    def kept(cls, size_px: tuple[int, int], array: Floats) -> MapDrift:
        """A drift that was kept as an `array`."""
        left = array[9:].reshape(*_PARTS, 2)
        return cls(size_px, array[:4], array[4:8], left, int(array[8]))

    @property
    def array(self) -> Floats:
        """All of it but the size, (33,)."""
        return np.concatenate([self.numbers, self.sigma, [self.count], self.left.ravel()])

    @property
    def of_field(self) -> Floats:
        """The same as a homography (3, 3) from field to field, for `Map.then`."""
        right, down, growth, turn = self.numbers
        middle, to_px = np.eye(3), np.diag([*self.size_px, 1.0])
        middle[:2, 2] = 0.5 * np.array(self.size_px)
        about = np.array([[1.0 + growth, -turn, right], [turn, 1.0 + growth, down], [0, 0, 1]])
        there = middle @ about @ np.linalg.inv(middle)
        return np.asarray(np.linalg.inv(to_px) @ there @ to_px)

    @property
    def unlike_px(self) -> float:
        """The residual after shift, turn and growth, in the part where it is largest."""
        return float(np.hypot(*self.left.reshape(-1, 2).T).max())

    @property
    def worst_px(self) -> tuple[float, float]:
        """How far the corner that moved most has moved, and its standard deviation."""
        corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * self.size_px
        moved = float(np.hypot(*(self(corners) - corners).T).max())
        reach = 0.5 * float(np.hypot(*self.size_px))
        return moved, float(np.hypot(self.sigma[:2].max(), reach * self.sigma[2:].max()))

    def __call__(self, points: Floats) -> Floats:
        """Points (..., 2) as the maps have them -> points as they are."""
        near = points - 0.5 * np.array(self.size_px)
        return np.asarray(points + _slopes(near) @ self.numbers)

    def since(self, then: MapDrift) -> MapDrift:
        """What has changed since then, where both drifts are small."""
        return MapDrift(
            self.size_px,
            self.numbers - then.numbers,
            np.hypot(self.sigma, then.sigma),
            self.left - then.left,
            min(self.count, then.count),
        )


def fit_map_drift(
    size_px: tuple[int, int], believed: Floats, found: Floats, sigma: Floats
) -> MapDrift:
    """Fit points by the maps and where they are, (n, 2) each, so that outliers count little.

    sigma : (n,) of a point; enlarged to the real scatter.
    """
    slopes = _slopes(believed - 0.5 * np.array(size_px)) / sigma[:, None, None]
    wanted = (found - believed) / sigma[:, None]
    numbers = np.append(np.median(found - believed, axis=0), (0.0, 0.0))
    flat = slopes.reshape(-1, 4)
    scatter = 1.0
    for loss in ("soft_l1", "cauchy"):  # the first from anywhere, the second for outliers
        solved = least_squares(
            lambda v: flat @ v - wanted.ravel(),
            numbers,
            jac=lambda v: flat,
            loss=loss,
            f_scale=_CAUCHY * scatter,
            x_scale="jac",
        )
        numbers = np.asarray(solved.x, dtype=np.float64)
        scatter = max(1.0, _TO_SIGMA * float(np.median(np.abs(solved.fun))))
    spread = scatter * np.sqrt(np.diagonal(np.linalg.inv(solved.jac.T @ solved.jac)))
    rest = (wanted - slopes @ numbers) * sigma[:, None]
    left = np.zeros((*_PARTS, 2))
    col, row = np.clip(believed / size_px * _PARTS[::-1], 0, np.array(_PARTS[::-1]) - 1e-6).T
    for part in np.ndindex(_PARTS):
        inside = (row.astype(int) == part[0]) & (col.astype(int) == part[1])
        if inside.sum() >= _FEWEST:
            left[part] = np.median(rest[inside], axis=0)
    return MapDrift(size_px, numbers, spread, left, len(believed))


def _slopes(near: Floats) -> Floats:
    """How points (..., 2), relative to the middle, move with the four numbers: (..., 2, 4)."""
    x, y = near[..., 0], near[..., 1]
    one, none = np.ones_like(x), np.zeros_like(x)
    rows = [np.stack([one, none, x, -y], axis=-1), np.stack([none, one, y, x], axis=-1)]
    return np.stack(rows, axis=-2)
