"""A smooth correction of a map, from offsets measured at scattered places.

The correction is the spline of a map's own residual (`pdcd.panels.distortion`): its nodes are
fitted to the offsets, by reweighted least squares (Cauchy), with a penalty on second differences
that extends it to where nothing was measured. So it can be added to the map's residual without
loss, and repeated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.geometry.fit import compute_second_differences, compute_spline_basis
from pdcd.calibration.registration.offsets import MaskOffsets
from pdcd.errors import CalibrationError
from pdcd.panels.distortion import MapResidual
from pdcd.panels.map import Map, map_between
from pdcd.panels.map_soundness import check_map

_NODES = (8, 10)
"""Rows and columns of a correction, at least."""
_STIFF = 0.07
"""Standard deviation of second differences of nodes, in pixels."""
_ROUNDS = 4
"""Reweighted solves."""
_CAUCHY = 2.5
"""Scale of the weights, in standard deviations."""
_TO_SIGMA = 1.4826
"""From the median of absolute deviations to a standard deviation."""
_PATCHES, _GROUPS = (12, 16), 10
"""Rows and columns of patches of a device, and groups of patches; each group is left out once to
estimate the errors."""
_FEWEST = 12
"""Offsets that a correction needs."""


@dataclass(frozen=True, eq=False)
class MapCorrection:
    """A smooth field of displacements over a device.

    nodes : (rows, cols, 2) in projector pixels (right, down), evenly over the device, edges
        included. covariance : (2, nodes, nodes), of each axis.
    left_px : (n, 2), residuals of the offsets it was fitted to.
    """

    size_px: tuple[int, int]
    nodes: Floats
    covariance: Floats
    left_px: Floats

    def at(self, points_px: Floats) -> Floats:
        """Displacement at points (n, 2) of the device, (n, 2) in projector pixels."""
        return MapResidual(self.nodes, self.size_px).at(points_px)

    def sigma_at(self, points_px: Floats) -> Floats:
        """Its standard deviation there, (n, 2)."""
        basis = compute_spline_basis(
            points_px, self.size_px, (self.nodes.shape[0], self.nodes.shape[1])
        )
        found = [np.einsum("np,pq,nq->n", basis, each, basis) for each in self.covariance]
        return np.asarray(np.sqrt(np.stack(found, axis=-1)))


def fit_map_correction(offsets: MaskOffsets, mask: Map) -> MapCorrection:
    """Fit the smooth offset of the mask's map.

    Errors of the offsets are taken from `sigma_px`, enlarged to their real scatter. Raises
    CalibrationError for fewer than 12 offsets.
    """
    points = offsets.points_px
    good = np.isfinite(points).all(axis=-1) & np.isfinite(offsets.offset_px).all(axis=-1)
    if good.sum() < _FEWEST:
        raise CalibrationError(
            f"{good.sum()} offsets are too few for a correction; {_FEWEST} are needed",
            device="mask",
            hint="clear the field, and put a flat bright card across all of it",
        )
    shape = _nodes_of(mask)
    basis = compute_spline_basis(points[good], mask.size_px, shape)
    stiff = compute_second_differences(shape) / _STIFF
    group = _groups(points[good], mask.size_px)
    solved = [
        _solved(basis, stiff, offsets.offset_px[good, axis], offsets.sigma_px[good, axis], group)
        for axis in (0, 1)
    ]
    nodes = np.stack([nodes for nodes, _ in solved], axis=-1)
    left = offsets.offset_px[good] - basis @ nodes
    covariance = np.stack([each for _, each in solved])
    return MapCorrection(mask.size_px, nodes.reshape(*shape, 2), covariance, left)


def correct_mask_map(mask: Map, projector: Map, correction: MapCorrection) -> Map:
    """The mask's map without the offset that was measured with it.

    Raises ConfigError (`pdcd.panels.map_soundness`) where the corrected map cannot be used.
    """

    def meant(points_px: Floats) -> Floats:
        believed = map_between(mask, projector, points_px)
        return projector.to_field(believed - correction.at(points_px))

    return adjust_map_residual(mask, meant, correction.nodes.shape[:2], "mask")


def adjust_map_residual(
    map_: Map, meant: Callable[[Floats], Floats], shape: tuple[int, ...], device: str
) -> Map:
    """The map with another residual, by which its nodes lie where they are meant to.

    meant : from points (n, 2) of the device to the field, (n, 2). shape : (rows, cols) of nodes.
    """
    points = _nodes_px(map_.size_px, shape)
    back = np.linalg.inv(np.array(map_.homography).reshape(3, 3))
    wanted = meant(points) @ back[:, :2].T + back[:, 2]
    straight = wanted[:, :2] / wanted[:, 2:]
    plain = msgspec.structs.replace(map_, residual=())
    through_lens = plain.to_field(points) @ back[:, :2].T + back[:, 2]
    moved = (straight - through_lens[:, :2] / through_lens[:, 2:]).reshape(*shape, 2)
    nodes = tuple(tuple((right, down) for right, down in row) for row in moved.tolist())
    return check_map(msgspec.structs.replace(map_, residual=nodes), device)


def _solved(
    basis: Floats, stiff: Floats, wanted: Floats, sigma: Floats, group: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Nodes (p,) of one axis and their covariance (p, p).

    Neighbours have correlated errors, so that formulas for independent errors are too optimistic.
    The covariance is that of a jackknife over groups of patches, plus that of the fit with its
    stiffness, which counts where nothing was measured.
    """
    scatter, weight = np.maximum(sigma, 1e-6), np.ones(wanted.size)
    for _ in range(_ROUNDS):
        rows = basis * (np.sqrt(weight) / scatter)[:, None]
        meant = wanted * np.sqrt(weight) / scatter
        normal = rows.T @ rows + stiff.T @ stiff
        inverse = np.linalg.inv(normal)
        nodes = inverse @ (rows.T @ meant)
        left = wanted - basis @ nodes
        spread = _TO_SIGMA * float(np.median(np.abs(left)))
        # Few nodes are fitted to many offsets, so the residuals scatter as the offsets do.
        scatter = np.hypot(sigma, np.sqrt(max(0.0, spread**2 - float(np.median(sigma**2)))))
        scatter = np.maximum(scatter, 1e-6)
        weight = 1.0 / (1.0 + (left / (_CAUCHY * scatter)) ** 2)
    covariance = np.asarray(inverse, dtype=np.float64)
    for number in range(_GROUPS):
        some = group == number
        without = normal - rows[some].T @ rows[some]
        change = np.linalg.solve(without, (rows[~some].T @ meant[~some])) - nodes
        covariance = covariance + (_GROUPS - 1) / _GROUPS * np.outer(change, change)
    return nodes, covariance


def _groups(points: Floats, size_px: tuple[int, int]) -> NDArray[np.int64]:
    """The group with which each point is left out: a small patch of the device is left out as a
    whole."""
    rows, cols = _PATCHES
    col, row = np.floor(points / np.array(size_px) * (cols, rows)).astype(np.int64).T
    return np.asarray((3 * row + 4 * col) % _GROUPS)


def _nodes_of(map_: Map) -> tuple[int, int]:
    """Rows and columns of nodes: the map's own, with so many added in between that the minimum is
    met and none of the old ones moves."""
    own = np.shape(map_.residual)[:2] if map_.residual else (2, 2)
    gaps = [
        (have - 1) * ceil((least - 1) / (have - 1)) for have, least in zip(own, _NODES, strict=True)
    ]
    return gaps[0] + 1, gaps[1] + 1


def _nodes_px(size_px: tuple[int, int], shape: tuple[int, ...]) -> Floats:
    """Where nodes lie on a device, (rows * cols, 2) in pixels."""
    x, y = (np.linspace(0.0, size, n) for size, n in zip(size_px, shape[::-1], strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
