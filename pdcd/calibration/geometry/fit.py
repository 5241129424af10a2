"""A map fitted to points of one device and where they lie on another: robust, with its errors.

The model is that of `pdcd.panels.map.Map`: with u a point of the source in half heights from its
middle,

    straight = u (1 + k1 r^2 + k2 r^4) + residual(u),    target = H straight,

where the residual is a cubic spline through nodes over the source. H is started by USAC_MAGSAC; its
eight numbers and k1, k2 are refined by least squares with the soft L1 loss; then all numbers, nodes
included, are fitted at once by Gauss-Newton with Cauchy weights. Second differences of the nodes
are held small, so that the residual stays smooth and goes on straight where there are no points.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from pdcd.arrays import Bools, Floats
from pdcd.errors import CalibrationError, ConfigError
from pdcd.panels.distortion import ResidualNodes
from pdcd.panels.map import Map, to_map_matrix
from pdcd.panels.map_soundness import check_map

_NODES = (8, 10)
"""Rows and columns of nodes of the residual."""
_START_SHARE = 0.01
"""Error, over the target's width, that a homography alone is allowed to leave: lenses bend."""
_LEAST_POINTS, _LEAST_START = 20, 0.2
"""Points that a map needs, and the share of them that a homography alone must fit roughly."""
_LENS_LOSS_PX = 1.0
"""Error beyond which the first fit counts points less: it still contains the residual."""
_LENS_POINTS = 2000
"""Points, at most, that the first fit uses."""
_NODE_SD_PX, _BEND_SD_PX, _LENS_SD = 2.0, 1.0, 0.3
"""Priors, as standard deviations: of nodes, of their second differences, of k1 and k2."""
_CAUCHY = 2.5
"""A point counts half where its error is so many median errors."""
_RAYLEIGH = np.sqrt(2.0 * np.log(2.0))
"""Median length of an error in two axes, over the standard deviation in one."""
_SLIGHT = 0.05
"""Least median error, in sigmas, that the weights are scaled by."""
_ROUNDS = 6
_INLIER_SIGMAS = 5.0
_LEAST_INLIER_PX = 0.05
"""Error below which no point is an outlier, however well the others fit."""
_LENS = 10
"""Numbers before those of the nodes."""


@dataclass(frozen=True, eq=False)
class PointPairs:
    """Points of one device and where they lie on another.

    source_px, target_px : (n, 2), pixels of both devices.
    sigma_px : (n, 2), standard deviation in target pixels, the errors of both sides together.
    """

    source_px: Floats
    target_px: Floats
    sigma_px: Floats


@dataclass(frozen=True, eq=False)
class FittedMap:
    """A map from a source to a target, and how sure it is.

    map : from the source's pixels to the unit square that the target's pixels fill.
    target_size_px : (width, height).
    parameters : (10 + 2 nodes,): H in half heights with its last number 1, k1, k2, then all nodes
        to the right and all nodes down, in half heights of the source.
    covariance : of these.
    source_px, target_px, residual_px : (n, 2), where the points lie on either, and the residual of
        the fit, in target pixels.
    inlier : (n,) bool.
    nodes : (rows, columns) of the residual.
    """

    map: Map
    target_size_px: tuple[int, int]
    parameters: Floats
    covariance: Floats
    source_px: Floats
    target_px: Floats
    residual_px: Floats
    inlier: Bools
    nodes: tuple[int, int]

    def to_target(self, source_px: Floats) -> Floats:
        """Points of the source (..., 2) -> target pixels (..., 2); NaN behind the horizon."""
        return self.map.to_field(source_px) * self.target_size_px

    def slope(self, source_px: Floats) -> Floats:
        """d(target pixel) / d(source pixel), (..., 2, 2)."""
        return self.map.jacobian(source_px) * np.array(self.target_size_px, np.float64)[:, None]

    def covariance_px(self, source_px: Floats) -> Floats:
        """Covariance of `to_target` at points (n, 2), (n, 2, 2), in target pixels squared."""
        model = _Model(self.map.size_px, self.target_size_px, self.nodes)
        by = model.slopes(self.parameters, model.basis(source_px), model.near(source_px))
        found: Floats = np.einsum("nip,pq,njq->nij", by, self.covariance, by, optimize=True)
        return found * (0.5 * self.target_size_px[1]) ** 2

    def sigma_px(self, source_px: Floats) -> Floats:
        """Standard deviation of `to_target` at points (n, 2), (n, 2), in target pixels."""
        return np.sqrt(np.diagonal(self.covariance_px(source_px), axis1=1, axis2=2))


def fit_map(
    pairs: PointPairs,
    source_size_px: tuple[int, int],
    target_size_px: tuple[int, int],
    device: str,
    *,
    nodes: tuple[int, int] = _NODES,
) -> FittedMap:
    """The map that fits the pairs best. Deterministic: the same pairs give the same map.

    Raises CalibrationError where no homography fits enough points roughly, or the map folds.
    """
    model = _Model(source_size_px, target_size_px, nodes)
    near, wanted = model.near(pairs.source_px), model.wanted(pairs.target_px)
    unit = 0.5 * target_size_px[1]
    sigma = np.maximum(pairs.sigma_px, 1e-6) / unit
    start = _start(pairs, near, wanted, target_size_px, device)
    lens = _lens(model, start, near, wanted, _LENS_LOSS_PX / unit)
    numbers = np.concatenate([lens, np.zeros(2 * nodes[0] * nodes[1])])
    basis = model.basis(pairs.source_px)
    prior = model.prior(numbers.size)
    for _ in range(_ROUNDS):
        error = wanted - model.target(numbers, basis, near)
        lengths = np.hypot(*(error / sigma).T)
        middle = max(float(np.median(lengths)), _SLIGHT)
        weight = 1.0 / (1.0 + (lengths / (_CAUCHY * middle)) ** 2)
        # Errors over what noise alone would leave: sigmas are multiplied by it where it is above 1.
        scatter = max(middle / _RAYLEIGH, _together(model, near, error / sigma, lengths, nodes))
        per = np.sqrt(weight)[:, None] / (sigma * max(scatter, 1.0))
        rows = (model.slopes(numbers, basis, near) * per[..., None]).reshape(-1, numbers.size)
        normal = rows.T @ rows + prior
        step = np.linalg.solve(normal, rows.T @ (error * per).ravel() - prior @ numbers)
        numbers = numbers + step
    covariance = np.asarray(np.linalg.inv(normal))
    error = wanted - model.target(numbers, basis, near)
    residual_px = error * unit
    return FittedMap(
        map=_sound(model.map(numbers), device),
        target_size_px=target_size_px,
        parameters=numbers,
        covariance=covariance,
        source_px=pairs.source_px,
        target_px=pairs.target_px,
        residual_px=residual_px,
        inlier=_inliers(residual_px),
        nodes=nodes,
    )


def _together(
    model: _Model, near: Floats, error: Floats, lengths: Floats, nodes: tuple[int, int]
) -> float:
    """Scatter of errors, in their sigmas, of means of neighbours. Where neighbours have correlated
    errors, which do not average out, it is larger than the scatter of single points.

    Neighbours are averaged in pieces of half the distance of nodes, which no residual follows.
    """
    good = lengths < _INLIER_SIGMAS * np.median(lengths)
    wide = model.aspect
    rows, cols = 2 * nodes[0], 2 * nodes[1]
    row = np.clip((0.5 * near[good, 1] + 0.5) * rows, 0, rows - 1).astype(np.int64)
    col = np.clip((0.5 * near[good, 0] / wide + 0.5) * cols, 0, cols - 1).astype(np.int64)
    piece = row * cols + col
    count = np.bincount(piece, minlength=rows * cols)
    sums = np.stack([np.bincount(piece, error[good, axis], rows * cols) for axis in (0, 1)])
    per = sums[:, count > 0] / np.sqrt(count[count > 0])
    return float(np.median(np.hypot(*per))) / float(_RAYLEIGH)


def mad_px(residual_px: Floats) -> float:
    """Median of the lengths of errors (n, 2)."""
    return float(np.median(np.hypot(residual_px[:, 0], residual_px[:, 1])))


def _inliers(residual_px: Floats) -> Bools:
    limit = max(_INLIER_SIGMAS * mad_px(residual_px) / float(_RAYLEIGH), _LEAST_INLIER_PX)
    found: Bools = np.hypot(residual_px[:, 0], residual_px[:, 1]) < limit
    return found


def _start(
    pairs: PointPairs, near: Floats, wanted: Floats, target_size_px: tuple[int, int], device: str
) -> Floats:
    """H by MAGSAC, in half heights, its first eight numbers, and no distortion: (10,)."""
    reach = _START_SHARE * 2.0 * target_size_px[0] / target_size_px[1]
    found, most = None, 0
    # OpenCV takes no sample of points that is mirrored, so a mirrored picture is turned over first.
    for mirror in (np.eye(3), np.diag([-1.0, 1.0, 1.0])) if len(near) >= _LEAST_POINTS else ():
        points = near * np.diag(mirror)[:2]
        tried, kept = cv2.findHomography(points, wanted, cv2.USAC_MAGSAC, reach, maxIters=5000)
        if tried is not None and abs(tried[2, 2]) > 1e-9 and int(kept.sum()) > most:
            found, most = np.asarray(tried, dtype=np.float64) @ mirror, int(kept.sum())
    if found is None or most < _LEAST_START * len(near):
        raise CalibrationError(
            f"no flat picture of the {device} fits the {len(near)} points that were found",
            device=device,
            hint="put a flat matt card there, and see that nothing moves meanwhile",
        )
    flat = (found / found[2, 2]).ravel()[:8]
    return np.concatenate([flat, np.zeros(2)])


def _lens(model: _Model, start: Floats, near: Floats, wanted: Floats, loss: float) -> Floats:
    """H and the lens, refined, (10,)."""
    some = slice(None, None, max(1, len(near) // _LENS_POINTS))
    few, there = near[some], wanted[some]

    def errors(numbers: Floats) -> Floats:
        error = (model.through(numbers, model.straight(numbers, few)) - there) / loss
        # Where all points lie in the middle, nothing else constrains the lens.
        held = numbers[8:10] / _LENS_SD * np.sqrt(len(few)) * 0.01
        return np.concatenate([np.clip(error, -1e6, 1e6).ravel(), held])

    found = least_squares(errors, start, loss="soft_l1", x_scale="jac", max_nfev=100)
    return np.asarray(found.x, dtype=np.float64)


class _Model:
    """The model in half heights of source and target, from their middles."""

    def __init__(
        self,
        source_size_px: tuple[int, int],
        target_size_px: tuple[int, int],
        nodes: tuple[int, int],
    ) -> None:
        self._source = np.array(source_size_px, dtype=np.float64)
        self._target = np.array(target_size_px, dtype=np.float64)
        self._nodes = nodes

    @property
    def aspect(self) -> float:
        """Width over height of the source."""
        return float(self._source[0] / self._source[1])

    def near(self, source_px: Floats) -> Floats:
        """Source pixels in half heights from the middle."""
        found: Floats = (source_px - 0.5 * self._source) / (0.5 * self._source[1])
        return found

    def wanted(self, target_px: Floats) -> Floats:
        """Target pixels in half heights from the middle."""
        found: Floats = (target_px - 0.5 * self._target) / (0.5 * self._target[1])
        return found

    def basis(self, source_px: Floats) -> Floats:
        """See `compute_spline_basis`."""
        return compute_spline_basis(source_px, self._source, self._nodes)

    def straight(self, numbers: Floats, near: Floats) -> Floats:
        """Points without the lens, the residual not yet added."""
        r2 = (near**2).sum(axis=1, keepdims=True)
        found: Floats = near * (1.0 + r2 * (numbers[8] + r2 * numbers[9]))
        return found

    def through(self, numbers: Floats, straight: Floats) -> Floats:
        """Straight points -> the target."""
        full = np.append(numbers[:8], 1.0).reshape(3, 3)
        found = straight @ full[:, :2].T + full[:, 2]
        return np.asarray(found[:, :2] / found[:, 2:])

    def target(self, numbers: Floats, basis: Floats, near: Floats) -> Floats:
        """Where points lie on the target, (n, 2)."""
        return self.through(numbers, self._bent(numbers, basis, near))

    def _bent(self, numbers: Floats, basis: Floats, near: Floats) -> Floats:
        moved = basis @ numbers[_LENS:].reshape(2, -1).T
        return np.asarray(self.straight(numbers, near) + moved)

    def slopes(self, numbers: Floats, basis: Floats, near: Floats) -> Floats:
        """d(target) / d(numbers), (n, 2, numbers)."""
        straight = self._bent(numbers, basis, near)
        full = np.append(numbers[:8], 1.0).reshape(3, 3)
        per = 1.0 / (straight @ full[2, :2] + 1.0)
        place = self.through(numbers, straight)
        count = basis.shape[1]
        found = np.zeros((len(near), 2, numbers.size))
        for axis in (0, 1):
            found[:, axis, 3 * axis : 3 * axis + 2] = straight * per[:, None]
            found[:, axis, 3 * axis + 2] = per
            found[:, axis, 6:8] = -straight * (place[:, axis] * per)[:, None]
            # d(target) / d(straight)
            by = (full[axis, :2] - place[:, axis, None] * full[2, :2]) * per[:, None]
            r2 = (near**2).sum(axis=1)
            along = (by * near).sum(axis=1)
            found[:, axis, 8], found[:, axis, 9] = along * r2, along * r2 * r2
            found[:, axis, _LENS : _LENS + count] = by[:, :1] * basis
            found[:, axis, _LENS + count :] = by[:, 1:] * basis
        return found

    def prior(self, numbers: int) -> Floats:
        """Inverse covariance of the prior, whose mean is 0."""
        unit = 0.5 * self._source[1]
        rows, cols = self._nodes
        found = np.zeros((numbers, numbers))
        found[8, 8] = found[9, 9] = _LENS_SD**-2
        bends = compute_second_differences(self._nodes)
        held = bends.T @ bends * (unit / _BEND_SD_PX) ** 2
        held += np.eye(rows * cols) * (unit / _NODE_SD_PX) ** 2
        count = rows * cols
        found[_LENS : _LENS + count, _LENS : _LENS + count] = held
        found[_LENS + count :, _LENS + count :] = held
        return found

    def map(self, numbers: Floats) -> Map:
        """The same model as a `Map`."""
        width, height = self._source
        half, unit = 0.5 * height, 0.5 * self._target[1]
        into = np.array(
            [[1.0 / half, 0.0, -0.5 * width / half], [0.0, 1.0 / half, -1.0], [0.0, 0.0, 1.0]]
        )
        out = np.array([[unit, 0.0, 0.5 * self._target[0]], [0.0, unit, unit], [0.0, 0.0, 1.0]])
        full = np.append(numbers[:8], 1.0).reshape(3, 3)
        to_unit = np.diag([1.0 / self._target[0], 1.0 / self._target[1], 1.0])
        right, down = (numbers[_LENS:] * half).reshape(2, *self._nodes)
        nodes: ResidualNodes = tuple(
            tuple((float(x), float(y)) for x, y in zip(*row, strict=True))
            for row in zip(right, down, strict=True)
        )
        return Map(
            size_px=(int(width), int(height)),
            homography=to_map_matrix(to_unit @ out @ full @ into),
            radial=(float(numbers[8]), float(numbers[9])),
            residual=nodes,
        )


def compute_spline_basis(points_px: Floats, size_px: ArrayLike, nodes: tuple[int, int]) -> Floats:
    """Displacement at points (n, 2) of a device by a node of value 1: (n, nodes).
    `pdcd.panels.distortion.MapResidual` is the same spline."""
    rows, cols = nodes
    at = np.clip(points_px / np.asarray(size_px), 0.0, 1.0)
    across = CubicSpline(np.arange(cols), np.eye(cols))(at[:, 0] * (cols - 1))
    along = CubicSpline(np.arange(rows), np.eye(rows))(at[:, 1] * (rows - 1))
    return np.asarray((along[:, :, None] * across[:, None, :]).reshape(len(at), -1))


def compute_second_differences(nodes: tuple[int, int]) -> Floats:
    """Second differences of nodes down and across, (k, nodes)."""
    down, across = (np.diff(np.eye(count), n=2, axis=0) for count in nodes)
    rows, cols = (np.eye(count) for count in nodes)
    return np.vstack([np.kron(down, cols), np.kron(rows, across)])


def _sound(map_: Map, device: str) -> Map:
    try:
        return check_map(map_, device)
    except ConfigError as err:
        raise CalibrationError(
            f"{err.message}; points that far apart belong to no flat picture",
            device=device,
            hint="put a flat matt card there, fully lit, and see that nothing moves meanwhile",
        ) from err
