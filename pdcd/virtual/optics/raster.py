"""Smooth maps at the points of a raster: exact for few points, by polynomials for millions.

The inverse of a lens costs a microsecond a point, and a photo of twelve million samples has several
of them. Over a frame such a map is smooth: polynomials of the seventh degree, each through the
nodes about it, follow it. How closely they do is measured for each map; a map that they do not
follow is computed point by point. Lagrange's form needs only products: no fit, and no library that
takes longer to load than a small photo takes to compute.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats

PointMap = Callable[[Floats], Floats]
"""Points (..., 2) -> points (..., 2); NaN where there is none."""

EXACT_POINTS = 1 << 18
"""Rasters of no more points are never interpolated."""
_NODES = (65, 129)
"""Nodes a side that are tried."""
_DEGREE = 7
_CLOSE = 1e-5
"""Largest error of the polynomials at the points checked, in units of what `place` returns."""
_PROBES = 2000


class MapRaster:
    """A map at the points (x, y) of two ascending axes.

    place : the map; what it returns is in pixels, or in other units as fine.
    x, y : (w,) and (h,) float64
    """

    def __init__(self, place: PointMap, x: Floats, y: Floats) -> None:
        self._place, self._x, self._y = place, x, y
        self._fit: _Fit | None = None
        if x.size * y.size > EXACT_POINTS:
            found = (_fitted(place, x, y, nodes) for nodes in _NODES)
            self._fit = next((fit for fit in found if fit is not None), None)

    @property
    def exact(self) -> bool:
        """Whether every point is computed by the map itself."""
        return self._fit is None

    def rows(
        self, start: int, stop: int, aside: tuple[Floats, Floats] | None = None
    ) -> tuple[Floats, Floats]:
        """Where the points of some rows go: across and down, (stop - start, w) float64 each.

        aside : how far points lie to the right of their places on the raster and below them, in
            steps of it, at most half a step; (stop - start, w) each, at least two rows and columns.
        """
        if self._fit is None:
            points = np.stack(np.meshgrid(self._x, self._y[start:stop]), axis=-1)
            if aside is not None:
                step = self._x[1] - self._x[0], self._y[1] - self._y[0]
                points += np.stack(aside, axis=-1) * step
            places = self._place(points)
            return places[..., 0], places[..., 1]
        found = self._fit.rows(start, stop)
        return found if aside is None else (_moved(found[0], aside), _moved(found[1], aside))


@dataclass(frozen=True)
class _Fit:
    """A map by its nodes.

    down : (h, nodes) weights for the rows; only `_DEGREE` + 1 of a row are not 0
    first : (h,) the first of those
    across : for each coordinate, one matrix (nodes, w) for the columns
    """

    down: Floats
    first: NDArray[np.intp]
    across: list[Floats]

    def rows(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Where the points of some rows go: across and down."""
        near = slice(self.first[start], self.first[stop - 1] + _DEGREE + 1)
        down = self.down[start:stop, near]
        first, second = (down @ part[near] for part in self.across)
        return first, second


def _moved(places: Floats, aside: tuple[Floats, Floats]) -> Floats:
    """One coordinate at points beside those of a raster, by its slope between points: a map that
    polynomials follow is straight enough for that over half a step."""
    down, across = np.gradient(places)
    return np.asarray(places + aside[0] * across + aside[1] * down)


def _fitted(place: PointMap, x: Floats, y: Floats, nodes: int) -> _Fit | None:
    """A fit with that many nodes a side; None where the map is not smooth enough."""
    axes = [np.linspace(points[0], points[-1], nodes) for points in (x, y)]
    values = place(np.stack(np.meshgrid(*axes), axis=-1))
    if not np.isfinite(values).all():
        return None
    (columns, _), (down, first) = (_weights(points, nodes) for points in (x, y))
    across = [np.ascontiguousarray(values[..., part] @ columns.T) for part in (0, 1)]
    fitted = _Fit(down, first, across)
    return fitted if _follows(place, x, y, fitted) else None


def _weights(points: Floats, nodes: int) -> tuple[Floats, NDArray[np.intp]]:
    """Lagrange's weights of evenly spaced nodes at ascending points, (P, nodes), and the first node
    of each point whose weight is not 0, (P,): the `_DEGREE` + 1 nodes around the point count."""
    place = (points - points[0]) * ((nodes - 1) / (points[-1] - points[0]))
    first = np.clip(np.floor(place).astype(np.intp) - _DEGREE // 2, 0, nodes - _DEGREE - 1)
    window = np.arange(_DEGREE + 1)
    away = (place - first)[:, None] - window
    found = np.zeros((len(points), nodes))
    for node in window:
        others = window != node
        weight = np.prod(away[:, others] / (node - window[others]), axis=1)
        found[np.arange(len(points)), first + node] = weight
    return found, first


def _follows(place: PointMap, x: Floats, y: Floats, fitted: _Fit) -> bool:
    """Whether the fit is close to the map at some thousand points of the raster."""
    rng = np.random.default_rng(0)
    column, row = rng.integers(x.size, size=_PROBES), rng.integers(y.size, size=_PROBES)
    true = place(np.stack([x[column], y[row]], axis=-1))
    rows = fitted.down[row]
    found = [np.einsum("ij,ji->i", rows, part[:, column]) for part in fitted.across]
    return bool(np.abs(np.stack(found, axis=-1) - true).max() <= _CLOSE)
