"""A map: where each pixel of a device lies on the field.

The *field* is the rectangle that code cells divide. It has no pixels: x runs from 0 at its left
edge to 1 at its right one, y from 0 at the top to 1 at the bottom, as the projector sees the scene.
Projector, mask and camera each have a map to it (docs/calibration.md).

Pixel k of a device covers k to k + 1, so that its centre is at k + 0.5. A pixel of the camera is a
Bayer quad. A point of the device goes to the field in two steps:

1. distortion is removed (`pdcd.panels.distortion`): that of a lens about the device's centre, plus
   a smooth residual;
2. a homography leads from pixels to the field.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdcd.arrays import Floats
from pdcd.panels import distortion as lens
from pdcd.panels.distortion import MapResidual, ResidualNodes, make_residual

MapMatrix = tuple[float, float, float, float, float, float, float, float, float]
"""3 x 3, row by row."""

PIECE = 2**12
"""Points that are processed at a time: intermediate values stay in the processor's cache."""
_STEPS = 50
"""Most steps of Newton's method; from the homography's inverse a usual lens takes four."""
_CLOSE_PX = 1e-6
"""Length of a step below which it is the last: each step squares the error of the one before."""
_NODE_PX, _LEAST_NODES = 8.0, 48
"""Pixels between places at which maps are evaluated, and their least number along a side: lens
distortion between them is linear to less than a hundredth of a pixel."""


class Map(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """From the pixels of one device to the field; plain numbers, so that any file can hold it.

    size_px : (width, height) of the device.
    homography : from (x, y, 1) in pixels, distortion removed, to the field.
    radial : k1, k2 of ``1 + k1 r^2 + k2 r^4``, r in half heights from the centre.
    tangential : p1, p2, in the same unit.
    residual : displacement in pixels before the homography; () where there is none.

    Any numbers make a map; `pdcd.panels.map_soundness.check_map` says which of them can be used.
    """

    size_px: tuple[int, int]
    homography: MapMatrix
    radial: tuple[float, float] = (0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)
    residual: ResidualNodes = ()

    @classmethod
    def filling(cls, size_px: tuple[int, int]) -> Map:
        """The map of a device whose pixels are spread evenly over the field, upright."""
        width, height = size_px
        return cls(
            size_px=size_px, homography=to_map_matrix(np.diag([1.0 / width, 1.0 / height, 1.0]))
        )

    def to_field(self, points_px: ArrayLike) -> Floats:
        """Points of the device (..., 2) as (x, y) in pixels -> of the field, (..., 2) float64.

        They may lie beyond the device's edges. NaN behind the homography's horizon, seen from the
        device's centre.
        """
        full, ahead, residual = self._matrix, self._ahead, self._residual
        return _by_pieces(
            points_px, (2,), lambda piece: _projected(full, ahead, self._straight(piece, residual))
        )

    def from_field(self, points: ArrayLike) -> Floats:
        """Points of the field (..., 2) -> of the device in pixels, (..., 2) float64.

        They may lie beyond the device's edges. NaN where no point of the device was found: behind
        the horizon, and beyond the fold of a distortion.
        """
        inverse = np.asarray(np.linalg.inv(self._matrix), dtype=np.float64)
        ahead, residual = self._ahead, self._residual

        def found(piece: Floats) -> Floats:
            wanted = _projected(inverse, ahead, piece)
            return self._bent(wanted, residual) if self.bends else wanted

        return _by_pieces(points, (2,), found)

    def jacobian(self, points_px: ArrayLike) -> Floats:
        """Derivative of the place on the field: (..., 2, 2), d(field) / d(pixel)."""
        full, ahead, residual = self._matrix, self._ahead, self._residual

        def found(piece: Floats) -> Floats:
            straight, slope = self._slope(piece, residual)
            scale = straight @ full[2, :2] + full[2, 2]
            place = _projected(full, ahead, straight)
            outer = (full[:2, :2] - place[:, :, None] * full[2, :2]) / scale[:, None, None]
            return np.asarray(outer @ slope)

        return _by_pieces(points_px, (2, 2), found)

    def centres(self) -> Floats:
        """Where the centre of each pixel lies on the field, (height, width, 2)."""
        width, height = self.size_px
        full, ahead, residual = self._matrix, self._ahead, self._residual
        x, y = (np.arange(side, dtype=np.float64) + 0.5 for side in (width, height))
        # Displacements first, as they are cheap for a whole grid; then row by row in their place.
        found = np.zeros((height, width, 2)) if residual is None else residual.on_grid(x, y)
        band = max(1, PIECE // width)
        for top in range(0, height, band):
            points = np.stack(np.meshgrid(x, y[top : top + band]), axis=-1)
            straight = self._through_lens(points) + found[top : top + band]
            found[top : top + band] = _projected(full, ahead, straight)
        return found

    def then(self, of_field: ArrayLike) -> Map:
        """The map followed by a homography (3, 3) from field to field."""
        whole = np.asarray(of_field, dtype=np.float64) @ self._matrix
        return msgspec.structs.replace(self, homography=to_map_matrix(whole))

    def binned(self, side: int) -> Map:
        """The same device with squares of pixels instead of single ones; `side`, that of a square,
        divides its width and height."""
        width, height = self.size_px
        nodes = [[(right / side, down / side) for right, down in row] for row in self.residual]
        return msgspec.structs.replace(
            self,
            size_px=(width // side, height // side),
            homography=to_map_matrix(self._matrix @ np.diag([side, side, 1.0])),
            residual=tuple(map(tuple, nodes)),
        )

    @property
    def _matrix(self) -> Floats:
        return np.array(self.homography, dtype=np.float64).reshape(3, 3)

    @property
    def _ahead(self) -> float:
        """The side of the horizon on which the device's centre lies: 1 or -1."""
        width, height = self.size_px
        g, h, i = self.homography[6:]
        return 1.0 if g * 0.5 * width + h * 0.5 * height + i > 0.0 else -1.0

    @property
    def _residual(self) -> MapResidual | None:
        return make_residual(self.residual, self.size_px) if self.residual else None

    @property
    def _through(self) -> bool:
        """Whether a lens distorts."""
        return any(self.radial) or any(self.tangential)

    @property
    def bends(self) -> bool:
        """Whether straight lines of the field are bent on the device."""
        return self._through or bool(self.residual)

    @property
    def is_upright(self) -> bool:
        """Whether columns and rows of the device are those of the field, mirrored or not."""
        _, skew, _, slant, _, _, *tilt, _ = self.homography
        return not (self.bends or any((skew, slant, *tilt)))

    @property
    def _centre(self) -> tuple[Floats, float]:
        """The point about which a lens distorts, and the unit of it, in pixels."""
        return 0.5 * np.array(self.size_px, dtype=np.float64), 0.5 * self.size_px[1]

    def _through_lens(self, points: Floats) -> Floats:
        """Points (..., 2) as they would be without the lens, in pixels."""
        if not self._through:
            return points
        centre, half = self._centre
        near = (points - centre) / half
        straight = lens.correct_distortion(near, self.radial, self.tangential)
        straight *= half
        straight += centre
        return straight

    def _straight(self, points: Floats, residual: MapResidual | None) -> Floats:
        """Points (n, 2) without distortion, in pixels."""
        straight = self._through_lens(points)
        return straight if residual is None else straight + residual.at(points)

    def _slope(self, points: Floats, residual: MapResidual | None) -> tuple[Floats, Floats]:
        """The same, and its derivative, (n, 2, 2)."""
        centre, half = self._centre
        straight = self._through_lens(points)
        slope = lens.compute_distortion_slope(
            (points - centre) / half, self.radial, self.tangential
        )
        if residual is None:
            return straight, slope
        more, steeper = residual.slope(points)
        return straight + more, slope + steeper

    def _bent(self, wanted: Floats, residual: MapResidual | None) -> Floats:
        """The points (n, 2) that are ``wanted`` without distortion; NaN where none is found."""
        centre, half = self._centre
        found = wanted.copy()
        left = np.flatnonzero(np.isfinite(wanted).all(axis=-1))
        sure = np.zeros(len(wanted), dtype=np.bool_)
        with np.errstate(all="ignore"):  # far outside the device the distortion may fold
            for _ in range(_STEPS):
                straight, slope = self._slope(found[left], residual)
                step, upright = _solved(slope, wanted[left] - straight)
                found[left] += step
                close = (np.abs(step) < _CLOSE_PX).all(axis=-1)
                sure[left[close]] = upright[close]
                left = left[~close]
                if left.size == 0:
                    break
            # Beyond the fold of a distortion, a root may be found that is not the point's.
            sure &= np.hypot(*((found - centre) / half).T) < lens.find_fold_radius(self.radial)
        found[~sure] = np.nan
        return found


def to_map_matrix(values: ArrayLike) -> MapMatrix:
    """A (3, 3) matrix as a map holds it, scaled by convention so that [2, 2] is 1."""
    flat = np.asarray(values, dtype=np.float64).reshape(3, 3)
    if flat[2, 2] != 0.0:
        with np.errstate(over="ignore", invalid="ignore"):  # a check refuses the result
            flat = flat / flat[2, 2]
    a, b, c, d, e, f, g, h, i = flat.ravel().tolist()
    return a, b, c, d, e, f, g, h, i


def map_between(source: Map, target: Map, points_px: ArrayLike) -> Floats:
    """Points of one device -> the points of another that lie on the same place of the field."""
    return target.from_field(source.to_field(points_px))


def _by_pieces(
    points: ArrayLike, each: tuple[int, ...], work: Callable[[Floats], Floats]
) -> Floats:
    """``work`` on points (..., 2), a few at a time; ``each`` is the shape of a result."""
    given = np.asarray(points, dtype=np.float64)
    if given.shape[-1:] != (2,):
        raise ValueError(f"points have x and y along their last axis, not {given.shape}")
    flat = given.reshape(-1, 2)
    found = np.empty((len(flat), *each))
    for start in range(0, len(flat), PIECE):
        found[start : start + PIECE] = work(flat[start : start + PIECE])
    return found.reshape(*given.shape[:-1], *each)


def _projected(full: Floats, ahead: float, points: Floats) -> Floats:
    """Points (..., 2) under a homography; NaN where they are not on the side ``ahead``."""
    x, y = points[..., 0], points[..., 1]
    scale = full[2, 0] * x + full[2, 1] * y + full[2, 2]
    with np.errstate(all="ignore"):
        per = np.where(scale * ahead > 0.0, 1.0 / scale, np.nan)
        found = np.empty(points.shape)
        for axis in (0, 1):
            found[..., axis] = (full[axis, 0] * x + full[axis, 1] * y + full[axis, 2]) * per
    return found


def _solved(slope: Floats, wanted: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Solves ``slope @ x = wanted`` for many 2 x 2 matrices; and where these are neither folded nor
    turned around."""
    a, b, c, d = slope[..., 0, 0], slope[..., 0, 1], slope[..., 1, 0], slope[..., 1, 1]
    right, down = wanted[..., 0], wanted[..., 1]
    det = a * d - b * c
    solved = np.stack([d * right - b * down, a * down - c * right], axis=-1) / det[..., None]
    return solved, (det > 0.0) & (a + d > 0.0)


@dataclass(frozen=True)
class PanelView:
    """One panel; `map` knows its size and where its pixels lie on the field."""

    role: Literal["projector", "mask"]
    map: Map

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.map.size_px

    @property
    def mask(self) -> bool:
        """Whether it is the mask, which has windows and blocks light."""
        return self.role == "mask"


def find_pixels_on(device: Map, other: Map, edge_px: float = 0.0) -> NDArray[np.bool_]:
    """Pixels of a device, (height, width), that lie wholly on another one, and not within `edge_px`
    of its edge, in its own pixels; if that is negative, they may reach so far beyond the edge.

    device, other : maps to one field.
    """
    width, height = device.size_px
    x, y = (
        np.linspace(0.0, n, 1 + max(math.ceil(n / _NODE_PX), _LEAST_NODES)) for n in (width, height)
    )
    nodes = map_between(device, other, np.stack(np.meshgrid(x, y), axis=-1))
    at = _interpolate_nodes(_interpolate_nodes(nodes, height).swapaxes(0, 1), width).swapaxes(0, 1)
    with np.errstate(invalid="ignore"):  # no number where the other one has no such place
        on = np.asarray((at >= edge_px) & (at <= np.array(other.size_px) - edge_px))
    inside = np.asarray(on.all(axis=-1))
    return np.asarray(inside[1:, 1:] & inside[1:, :-1] & inside[:-1, 1:] & inside[:-1, :-1])


def _interpolate_nodes(nodes: Floats, size: int) -> Floats:
    """Values at the ends of pixels, (size + 1, ...), of values at nodes evenly along them."""
    place = np.linspace(0.0, len(nodes) - 1.0, size + 1)
    first = np.minimum(place.astype(np.int64), len(nodes) - 2)
    share = (place - first).reshape(-1, *(1,) * (nodes.ndim - 1))
    return np.asarray((1.0 - share) * nodes[first] + share * nodes[first + 1])
