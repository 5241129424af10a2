"""A map: where each pixel of a device lies on the field.

The *field* is the rectangle that code cells divide. It has no pixels: x runs from 0 at its left
edge to 1 at its right one, y from 0 at the top to 1 at the bottom, as the projector sees the scene.
Projector, mask and camera each have a map to it.

Pixel k of a device covers k to k + 1, so that its centre is at k + 0.5. A pixel of the camera is a
Bayer quad. A point of the device goes to the field in three steps:

1. radial and tangential distortion about the device's centre, in units of half its height
   (Brown 1966, Decentering Distortion of Lenses);
2. a smooth residual in pixels, by a cubic spline through a grid of nodes over the device;
3. a homography from pixels to the field.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from scipy.interpolate import RectBivariateSpline

Floats = NDArray[np.float64]

Matrix = tuple[float, float, float, float, float, float, float, float, float]
"""3 x 3, row by row."""

Nodes = tuple[tuple[tuple[float, float], ...], ...]
"""(rows, cols) of (right, down) in pixels, evenly over the device, its edges included."""

STEPS = 50
"""Most steps of Newton's method; from the homography's inverse a usual lens takes four."""
CLOSE_PX = 1e-10
"""Where a step is shorter than that, the inverse is found."""


class Map(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """From the pixels of one device to the field; plain numbers, so that any file can hold it.

    size_px : (width, height) of the device.
    homography : from (x, y, 1) in pixels, distortion taken out, to the field.
    radial : k1, k2 of ``1 + k1 r^2 + k2 r^4``, r in half heights from the centre.
    tangential : p1, p2, in the same unit.
    residual : displacement in pixels before the homography; () where there is none.
    """

    size_px: tuple[int, int]
    homography: Matrix
    radial: tuple[float, float] = (0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)
    residual: Nodes = ()

    @classmethod
    def filling(cls, size_px: tuple[int, int]) -> Map:
        """The map of a device whose pixels are spread evenly over the field, upright."""
        width, height = size_px
        return cls(size_px=size_px, homography=matrix(np.diag([1.0 / width, 1.0 / height, 1.0])))

    def to_field(self, points_px: ArrayLike) -> Floats:
        """Points of the device (..., 2) as (x, y) in pixels -> of the field, (..., 2) float64.

        NaN where the homography sends a point beyond infinity.
        """
        points = np.asarray(points_px, dtype=np.float64)
        return _projected(self._matrix, self._straight(points)[0])

    def from_field(self, points: ArrayLike) -> Floats:
        """Points of the field (..., 2) -> of the device in pixels, (..., 2) float64.

        They may lie beyond the device's edges. NaN where no point of the device was found.
        """
        inverse = np.asarray(np.linalg.inv(self._matrix), dtype=np.float64)
        wanted = _projected(inverse, np.asarray(points, dtype=np.float64))
        if not self._bends:
            return wanted
        found = wanted.copy()
        step = np.full(found.shape, np.inf)
        with np.errstate(all="ignore"):  # far outside the device the distortion may fold
            for _ in range(STEPS):
                straight, slope = self._straight(found)
                step = _solved(slope, wanted - straight)
                found = found + step
                if not np.any(np.abs(step) > CLOSE_PX):
                    break
            # Beyond the fold of a distortion, a root may be found that is not the point's.
            folded = np.linalg.det(self._straight(found)[1]) <= 0.0
        lost = ~(np.abs(step) <= 1e3 * CLOSE_PX).all(axis=-1) | folded
        found[lost] = np.nan
        return found

    def jacobian(self, points_px: ArrayLike) -> Floats:
        """How the field moves with a point of the device: (..., 2, 2), d(field) / d(pixel)."""
        straight, slope = self._straight(np.asarray(points_px, dtype=np.float64))
        full = self._matrix
        scale = straight @ full[2, :2] + full[2, 2]
        place = _projected(full, straight)
        outer = full[:2, :2] - place[..., :, None] * full[2, :2]
        moved: Floats = (outer / scale[..., None, None]) @ slope
        return moved

    def then(self, of_field: ArrayLike) -> Map:
        """The map followed by a homography (3, 3) from field to field."""
        whole = np.asarray(of_field, dtype=np.float64) @ self._matrix
        return msgspec.structs.replace(self, homography=matrix(whole))

    def centres(self) -> Floats:
        """Where the centre of each pixel lies on the field, (height, width, 2)."""
        width, height = self.size_px
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        return self.to_field(np.stack([x, y], axis=-1))

    @property
    def _matrix(self) -> Floats:
        return np.array(self.homography, dtype=np.float64).reshape(3, 3)

    @property
    def _bends(self) -> bool:
        return any(self.radial) or any(self.tangential) or bool(self.residual)

    def _straight(self, points: Floats) -> tuple[Floats, Floats]:
        """Points without distortion, (..., 2) in pixels, and their slope (..., 2, 2)."""
        slope = np.zeros((*points.shape, 2))
        slope[..., 0, 0] = slope[..., 1, 1] = 1.0
        if not self._bends:
            return points, slope
        half = 0.5 * self.size_px[1]
        centre = 0.5 * np.array(self.size_px, dtype=np.float64)
        near = (points - centre) / half
        moved, bend = _distorted(near, self.radial, self.tangential)
        straight, slope = centre + half * moved, bend
        if self.residual:
            more, more_slope = _residual(self.residual, self.size_px, points)
            straight, slope = straight + more, slope + more_slope
        return straight, slope


def matrix(values: ArrayLike) -> Matrix:
    """A (3, 3) matrix as a map holds it, its largest entry below by convention: [2, 2] is 1."""
    flat = np.asarray(values, dtype=np.float64).reshape(3, 3)
    if flat[2, 2] != 0.0:
        flat = flat / flat[2, 2]
    a, b, c, d, e, f, g, h, i = flat.ravel().tolist()
    return a, b, c, d, e, f, g, h, i


def between(source: Map, target: Map, points_px: ArrayLike) -> Floats:
    """Points of one device -> the points of another that lie on the same place of the field."""
    return target.from_field(source.to_field(points_px))


def _projected(full: Floats, points: Floats) -> Floats:
    """Points under a homography; NaN where they would come from behind."""
    along = points @ full[:, :2].T + full[:, 2]
    scale = along[..., 2:]
    # The side on which the device lies is positive: [2, 2] is 1 at the pixel (0, 0).
    ahead = scale * np.sign(full[2, 2] or 1.0) > 0.0
    nowhere = np.full(points.shape, np.nan)
    return np.asarray(np.divide(along[..., :2], scale, out=nowhere, where=ahead))


def _distorted(
    near: Floats, radial: tuple[float, float], tangential: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Brown's model about the centre: points (..., 2) and their slope (..., 2, 2)."""
    (k1, k2), (p1, p2) = radial, tangential
    x, y = near[..., 0], near[..., 1]
    r2 = x * x + y * y
    factor, rate = 1.0 + r2 * (k1 + k2 * r2), 2.0 * k1 + 4.0 * k2 * r2
    moved = np.stack(
        [
            x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * factor + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
        ],
        axis=-1,
    )
    slope = np.empty((*near.shape, 2))
    slope[..., 0, 0] = factor + rate * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    slope[..., 0, 1] = slope[..., 1, 0] = rate * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    slope[..., 1, 1] = factor + rate * y * y + 2.0 * p2 * x + 6.0 * p1 * y
    return moved, slope


@lru_cache(maxsize=16)
def _splines(
    nodes: Nodes, size_px: tuple[int, int]
) -> tuple[RectBivariateSpline, RectBivariateSpline]:
    # Its import costs as much as all others of the display process, and few maps have a residual.
    from scipy.interpolate import RectBivariateSpline

    values = np.array(nodes, dtype=np.float64)
    rows, cols = values.shape[:2]
    down, right = np.linspace(0.0, size_px[1], rows), np.linspace(0.0, size_px[0], cols)
    order = {"kx": min(3, rows - 1), "ky": min(3, cols - 1)}
    first, second = (RectBivariateSpline(down, right, values[..., i], **order) for i in (0, 1))
    return first, second


def _residual(nodes: Nodes, size_px: tuple[int, int], points: Floats) -> tuple[Floats, Floats]:
    """Displacement (..., 2) in pixels and its slope; beyond the device as at its edge."""
    right = np.clip(points[..., 0], 0.0, size_px[0])
    down = np.clip(points[..., 1], 0.0, size_px[1])
    more, slope = np.empty(points.shape), np.empty((*points.shape, 2))
    inside = (right == points[..., 0]), (down == points[..., 1])
    for axis, spline in enumerate(_splines(nodes, size_px)):
        more[..., axis] = spline.ev(down, right)
        slope[..., axis, 0] = np.where(inside[0], spline.ev(down, right, dy=1), 0.0)
        slope[..., axis, 1] = np.where(inside[1], spline.ev(down, right, dx=1), 0.0)
    return more, slope


def _solved(slope: Floats, wanted: Floats) -> Floats:
    """``slope @ x = wanted`` for each of many 2 x 2 matrices."""
    a, b, c, d = slope[..., 0, 0], slope[..., 0, 1], slope[..., 1, 0], slope[..., 1, 1]
    right, down = wanted[..., 0], wanted[..., 1]
    return (
        np.stack([d * right - b * down, a * down - c * right], axis=-1) / (a * d - b * c)[..., None]
    )
