"""Smooth maps at the points of a raster: exact for few points, by a spline for millions.

The inverse of a lens costs a microsecond a point, and a photo of twelve million samples has several
of them. Over a frame such a map is smooth: a spline of the fifth order through some thousand nodes
follows it. How closely is measured for each map, and one that it does not follow is computed point
by point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Place = Callable[[Floats], Floats]
"""Points (..., 2) -> points (..., 2); NaN where there is none."""

EXACT_POINTS = 1 << 18
"""Rasters of no more points are never interpolated."""
NODES = (65, 129)
"""Nodes a side that are tried."""
DEGREE = 5
CLOSE = 1e-5
"""Largest error of a spline, in units of what `place` returns, as far as it is looked at."""
PROBES = 2000


class Raster:
    """A map at the points (x, y) of two ascending axes.

    place : the map; what it returns is in pixels, or in other units as fine.
    x, y : (w,) and (h,) float64
    """

    def __init__(self, place: Place, x: Floats, y: Floats) -> None:
        self._place, self._x, self._y = place, x, y
        self._spline: _Spline | None = None
        if x.size * y.size > EXACT_POINTS:
            found = (_fitted(place, x, y, nodes) for nodes in NODES)
            self._spline = next((spline for spline in found if spline is not None), None)

    @property
    def exact(self) -> bool:
        """Whether every point is computed by the map itself."""
        return self._spline is None

    def rows(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Where the points of some rows go: across and down, (stop - start, w) float64 each."""
        if self._spline is None:
            points = np.stack(np.meshgrid(self._x, self._y[start:stop]), axis=-1)
            places = self._place(points)
            return places[..., 0], places[..., 1]
        return self._spline.rows(start, stop)


@dataclass(frozen=True)
class _Spline:
    """A fitted map: `down` (h, nodes) for the rows, in each of which the nodes from `first` (h,) on
    take part, `DEGREE` + 1 of them; for each coordinate one matrix (nodes, w) for the columns."""

    down: Floats
    first: NDArray[np.intp]
    across: list[Floats]

    def rows(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Where the points of some rows go: across and down."""
        near = slice(self.first[start], self.first[stop - 1] + DEGREE + 1)
        down = self.down[start:stop, near]
        first, second = (down @ part[near] for part in self.across)
        return first, second


def _fitted(place: Place, x: Floats, y: Floats, nodes: int) -> _Spline | None:
    """The spline through so many nodes a side; None where the map is not that smooth."""
    # A third of what a daemon and its work process load with scipy; small rasters need none of it.
    from scipy.interpolate import BSpline, make_interp_spline

    axes = [np.linspace(points[0], points[-1], nodes) for points in (x, y)]
    values = place(np.stack(np.meshgrid(*axes), axis=-1))
    if not np.isfinite(values).all():
        return None
    knots = [make_interp_spline(axis, axis, k=DEGREE).t for axis in axes]
    inner = make_interp_spline(axes[1], values, k=DEGREE).c
    # The axis of a fit comes first in its coefficients.
    whole = make_interp_spline(axes[0], inner, k=DEGREE, axis=1).c.transpose(1, 0, 2)
    columns, down = (
        BSpline.design_matrix(points, knots_of, DEGREE)
        for points, knots_of in zip((x, y), knots, strict=True)
    )
    across = [np.ascontiguousarray((columns @ whole[..., part].T).T) for part in (0, 1)]
    fitted = _Spline(down.toarray(), down.indices[down.indptr[:-1]].astype(np.intp), across)
    return fitted if _follows(place, x, y, fitted) else None


def _follows(place: Place, x: Floats, y: Floats, fitted: _Spline) -> bool:
    """Whether the spline is close to the map at some thousand points of the raster."""
    rng = np.random.default_rng(0)
    column, row = rng.integers(x.size, size=PROBES), rng.integers(y.size, size=PROBES)
    true = place(np.stack([x[column], y[row]], axis=-1))
    rows = fitted.down[row]
    found = [np.einsum("ij,ji->i", rows, part[:, column]) for part in fitted.across]
    return bool(np.abs(np.stack(found, axis=-1) - true).max() <= CLOSE)
