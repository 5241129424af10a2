"""Radial and tangential distortion of a lens (Brown 1966, Decentering Distortion of Lenses).

Points are in units of half the height of the picture, from its centre: with r their distance from
there,

    straight = seen (1 + k1 r^2 + k2 r^4) + 2 (P . seen) seen + r^2 P,    P = (p2, p1).

The residual of a distortion without that of the lens is smooth, and is given at nodes over the
device. It is interpolated by the cubic spline of both axes, without a knot next to the edges
(parabolas for three nodes, lines for two). Beyond the device's edges it stays as it is there.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pdcd.arrays import Floats

_Pair = tuple[float, float]


def correct_distortion(near: Floats, radial: _Pair, tangential: _Pair) -> Floats:
    """Seen points (..., 2) -> straight ones, (..., 2)."""
    (k1, k2), (p1, p2) = radial, tangential
    x, y = near[..., 0], near[..., 1]
    r2 = x * x + y * y
    # 2 (P . seen) goes into the factor, as it changes the distance from the centre, too.
    factor = 1.0 + r2 * (k1 + k2 * r2) + 2.0 * (p2 * x + p1 * y)
    straight = np.empty(near.shape)
    straight[..., 0] = x * factor + p2 * r2
    straight[..., 1] = y * factor + p1 * r2
    return straight


def compute_distortion_slope(near: Floats, radial: _Pair, tangential: _Pair) -> Floats:
    """How straight points move with seen ones: (..., 2, 2), d(straight) / d(seen)."""
    (k1, k2), (p1, p2) = radial, tangential
    x, y = near[..., 0], near[..., 1]
    r2 = x * x + y * y
    factor, rate = 1.0 + r2 * (k1 + k2 * r2), 2.0 * k1 + 4.0 * k2 * r2
    found = np.empty((*near.shape, 2))
    found[..., 0, 0] = factor + rate * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    found[..., 0, 1] = found[..., 1, 0] = rate * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    found[..., 1, 1] = factor + rate * y * y + 2.0 * p2 * x + 6.0 * p1 * y
    return found


def find_fold_radius(radial: _Pair) -> float:
    """The distance from the centre at which the radial part folds; infinite if it never does.

    Beyond it a straight point may be seen twice, and only the inner one is in the picture.
    """
    k1, k2 = radial
    # The smallest positive root u = r^2 of 1 + 3 k1 u + 5 k2 u^2.
    roots = np.roots([5.0 * k2, 3.0 * k1, 1.0])
    folds = roots.real[(np.abs(roots.imag) == 0.0) & (roots.real > 0.0)]
    return float(np.sqrt(folds.min())) if folds.size else float("inf")


ResidualNodes = tuple[tuple[tuple[float, float], ...], ...]
"""(rows, cols) of (right, down) in pixels, evenly over the device, its edges included."""


class MapResidual:
    """The displacement of each point of a device, in pixels (right, down)."""

    def __init__(self, nodes: Floats, size_px: tuple[int, int]) -> None:
        """nodes : (rows, cols, 2) in pixels, at least 2 x 2; size_px : (width, height)."""
        # The display process starts three times as fast without it, and few maps have a residual.
        from scipy.interpolate import CubicSpline

        rows, cols = nodes.shape[:2]
        self._nodes, self._size = nodes, np.array(size_px, dtype=np.float64)
        self._last = np.array([cols - 1, rows - 1])
        powers = CubicSpline(np.arange(rows), nodes).c
        powers = CubicSpline(np.arange(cols), powers, axis=2).c
        # One row for each patch between nodes: powers down, powers right (the highest first), axis.
        self._patches = np.ascontiguousarray(powers.transpose(3, 1, 2, 0, 4)).reshape(-1, 32)

    def at(self, points: Floats) -> Floats:
        """Displacement at points (n, 2), in pixels, (n, 2)."""
        patch, s, t = self._found(points)
        return _cubic(_cubic(patch, t), s).T

    def slope(self, points: Floats) -> tuple[Floats, Floats]:
        """Displacement at points (n, 2), and its derivative, (n, 2, 2)."""
        patch, s, t = self._found(points)
        along = _cubic(patch, t)
        inside = (points >= 0.0) & (points <= self._size)
        rate = np.where(inside, self._last / self._size, 0.0).T
        found = np.empty((len(points), 2, 2))
        found[:, :, 0] = (_steepness(along, s) * rate[0]).T
        found[:, :, 1] = (_cubic(_steepness(patch, t), s) * rate[1]).T
        return _cubic(along, s).T, found

    def on_grid(self, x: Floats, y: Floats) -> Floats:
        """Displacement at all pairs of x (w,) and y (h,), in pixels, (h, w, 2)."""
        from scipy.interpolate import CubicSpline

        rows, cols = self._nodes.shape[:2]
        right, down = self._in_nodes(x, 0), self._in_nodes(y, 1)
        # Splines are sums of those through a single node.
        across: Floats = CubicSpline(np.arange(cols), np.eye(cols))(right)
        along: Floats = CubicSpline(np.arange(rows), np.eye(rows))(down)
        found = np.empty((y.size, x.size, 2))
        for axis in (0, 1):
            found[..., axis] = along @ self._nodes[..., axis] @ across.T
        return found

    def _in_nodes(self, pixels: Floats, axis: int) -> Floats:
        last = self._last[axis]
        return np.asarray(np.clip(pixels / self._size[axis] * last, 0.0, last))

    def _found(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """The patch of each point, (4, 4, 2, n), and where in it: right and down, 0 to 1."""
        right, down = self._in_nodes(points[:, 0], 0), self._in_nodes(points[:, 1], 1)
        cols, rows = self._last
        # NaN lies in no patch; any will do, as the result is NaN, too.
        col = np.fmin(np.fmax(right, 0.0), cols - 1).astype(np.intp)
        row = np.fmin(np.fmax(down, 0.0), rows - 1).astype(np.intp)
        # Numbers of a kind are contiguous, for fast arithmetic.
        patch = np.ascontiguousarray(self._patches[row * cols + col].T).reshape(4, 4, 2, -1)
        return patch, right - col, down - row


@lru_cache(maxsize=16)
def make_residual(nodes: ResidualNodes, size_px: tuple[int, int]) -> MapResidual:
    """The residual through nodes as a map holds them."""
    return MapResidual(np.array(nodes, dtype=np.float64), size_px)


def _cubic(powers: Floats, at: Floats) -> Floats:
    """A cubic, its powers along the first axis, the highest first."""
    found: Floats = powers[0] * at
    for power in (1, 2):
        found += powers[power]
        found *= at
    found += powers[3]
    return found


def _steepness(powers: Floats, at: Floats) -> Floats:
    """Derivative of the same."""
    found: Floats = powers[0] * (3.0 * at)
    found += 2.0 * powers[1]
    found *= at
    found += powers[2]
    return found
