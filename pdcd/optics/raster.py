"""Smooth maps at the points of a raster: exact for few points, by a spline for millions.

The inverse of a lens costs a microsecond a point, and a photo of twelve million samples has several
of them. Over a frame such a map is smooth: a spline of the fifth order through some thousand nodes
follows it. How closely is measured for each map, and one that it does not follow is computed point
by point.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

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
        self._spline: tuple[sparse.csr_array, list[Floats]] | None = None
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
        down, across = self._spline
        first, second = (np.asarray(down[start:stop] @ part) for part in across)
        return first, second


def _fitted(
    place: Place, x: Floats, y: Floats, nodes: int
) -> tuple[sparse.csr_array, list[Floats]] | None:
    """The map as a matrix for the rows, and for each coordinate one for the columns; None where it
    is not that smooth."""
    # A third of what a daemon and its work process load with scipy; small rasters need none of it.
    from scipy.interpolate import make_interp_spline

    axes = [np.linspace(points[0], points[-1], nodes) for points in (x, y)]
    values = place(np.stack(np.meshgrid(*axes), axis=-1))
    if not np.isfinite(values).all():
        return None
    knots = [make_interp_spline(axis, axis, k=DEGREE).t for axis in axes]
    inner = make_interp_spline(axes[1], values, k=DEGREE).c
    # The axis of a fit comes first in its coefficients.
    whole = make_interp_spline(axes[0], inner, k=DEGREE, axis=1).c.transpose(1, 0, 2)
    columns = _basis(x, knots[0])
    fitted = (
        _basis(y, knots[1]),
        [np.ascontiguousarray((columns @ whole[..., part].T).T) for part in (0, 1)],
    )
    return fitted if _follows(place, x, y, fitted) else None


def _basis(points: Floats, knots: Floats) -> sparse.csr_array:
    from scipy.interpolate import BSpline

    return sparse.csr_array(BSpline.design_matrix(points, knots, DEGREE))


def _follows(
    place: Place, x: Floats, y: Floats, fitted: tuple[sparse.csr_array, list[Floats]]
) -> bool:
    """Whether the spline is close to the map at some thousand points of the raster."""
    rng = np.random.default_rng(0)
    column, row = rng.integers(x.size, size=PROBES), rng.integers(y.size, size=PROBES)
    true = place(np.stack([x[column], y[row]], axis=-1))
    down, across = fitted
    rows = down[row].toarray()
    found = np.stack([np.einsum("ij,ji->i", rows, part[:, column]) for part in across], axis=-1)
    return bool(np.abs(found - true).max() <= CLOSE)
