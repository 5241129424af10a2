"""Light between matte surfaces: radiosity between coarse patches of a relief.

The surface is a height above the cell plane, seen and lit from above by parallel light. Cells are
gathered into patches, patches exchange light in closed form (every number of bounces at once),
and what arrives is laid out over the cells again::

    T_nm = a rho_n (W X W^T)_nm rho_m        X = (1 - K A R)^-1 K

with `a` the area of a cell, rho the albedo of the cells, W (N, p) the weights of the patches in
the cells, A and R the areas and albedos of the patches, and K the symmetric kernel of the form
factors, ``F_ij = K_ij A_j``. X is symmetric, and so is T: light paths can be reversed. The first
bounce (cell to camera at once) is not part of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.virtual.scene.effects import Array, Cells, TintedEffect, sum_products

_PATCHES = (12, 16)
"""Patches along rows and columns, at most; light between matte surfaces is smooth."""
_STEPS = 8
"""Places between two points at which a line is compared with the surface."""
_STEEPEST = 0.2
"""Smallest cosine taken for the slope of a surface: a step between two cells is no real slope."""


@dataclass(frozen=True, eq=False)
class Radiosity(TintedEffect):
    """Inter-reflection between patches, from the second bounce on.

    grid : (rows, cols)
    albedo : (N,) float64
        Reflectance of the cells, times the share of a cell's light that takes part.
    exchange : (p, p) float64
        ``a X`` of the module, symmetric; p = patch rows * patch columns.
    down, across : (rows, patch rows), (cols, patch columns) float64
        W as a Kronecker product: weights of the patches along either axis.
    """

    grid: tuple[int, int]
    albedo: Array
    exchange: Array
    down: Array
    across: Array

    def apply(self, light: Array) -> Array:
        """See `Effect.apply`."""
        batch = light.shape[0]
        leaving = (light * self.albedo).reshape(batch, *self.grid)
        gathered = self.down.T @ (leaving @ self.across)
        patches = gathered.reshape(batch, len(self.exchange))  # also where there are no rows
        arriving = (patches @ self.exchange).reshape(gathered.shape)
        spread = (self.down @ arriving) @ self.across.T
        return spread.reshape(light.shape) * self.albedo

    def probe(self, left: Array, right: Array) -> Array:
        """See `Effect.probe`."""
        return sum_products(left, self.apply(right))

    @cached_property
    def _weights(self) -> Any:
        """W as a sparse matrix (N, p)."""
        down, across = scipy.sparse.coo_array(self.down), scipy.sparse.coo_array(self.across)
        return scipy.sparse.kron(down, across, format="csr")

    def diagonal(self) -> Array:
        """See `Effect.diagonal`."""
        lit = self._weights @ self.exchange
        returned = np.asarray(self._weights.multiply(lit).sum(axis=1)).ravel()
        diagonal: Array = self.albedo**2 * returned
        return diagonal

    def entries(self, seen: Cells, lit: Cells) -> Array:
        """See `Effect.entries`."""
        arriving = np.asarray(self._weights @ self.exchange)
        passed = np.asarray(self._weights[seen].multiply(arriving[lit]).sum(axis=1)).ravel()
        return np.asarray(self.albedo[seen] * passed * self.albedo[lit])

    def dense(self) -> Array:
        """See `Effect.dense`."""
        weights = np.kron(self.down, self.across)
        dense: Array = self.albedo[:, None] * (weights @ self.exchange @ weights.T) * self.albedo
        return dense


@dataclass(frozen=True, eq=False)
class Relief:
    """A surface above the cell plane.

    height : (rows, cols) float64
    pitch : (row, column) size of a cell, in the unit of `height`
    """

    height: Array
    pitch: tuple[float, float]

    @cached_property
    def normals(self) -> Array:
        """Unit normals (rows, cols, 3) as (x along columns, y along rows, z to the camera)."""
        rise = [
            np.gradient(self.height, step, axis=axis) if self.height.shape[axis] > 1 else 0.0
            for axis, step in enumerate(self.pitch)
        ]
        normals = np.ones((*self.height.shape, 3))
        normals[..., 0], normals[..., 1] = -np.asarray(rise[1]), -np.asarray(rise[0])
        unit: Array = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
        return unit

    @cached_property
    def cosine(self) -> Array:
        """Cosine (rows, cols) of the light's angle on the surface, at least `_STEEPEST`."""
        return np.maximum(self.normals[..., 2], _STEEPEST)

    @cached_property
    def points(self) -> Array:
        """Centres of the cells (rows, cols, 3) in space."""
        rows, cols = self.height.shape
        y, x = np.meshgrid(
            self.pitch[0] * np.arange(rows), self.pitch[1] * np.arange(cols), indexing="ij"
        )
        return np.stack([x, y, self.height], axis=-1)


def make_radiosity_effects(
    name: str,
    relief: Relief,
    albedo: Array,
    tints: Sequence[Array],
    patches: tuple[int, int] = _PATCHES,
) -> tuple[Radiosity, ...]:
    """Return the inter-reflection of a matte relief, one effect for each column of `albedo`.

    Parameters
    ----------
    albedo : (N, C) float64, 0 <= albedo < 1
        Reflectance of the cells in C colours.
    tints : C arrays (3,)
        The colour that each column of `albedo` stands for.
    patches : patches along rows and columns, at most
    """
    rows, cols = relief.height.shape
    shape = (min(rows, patches[0]), min(cols, patches[1]))
    down, across = make_hat_weights(rows, shape[0]), make_hat_weights(cols, shape[1])
    cell = relief.pitch[0] * relief.pitch[1]
    kernel = compute_form_kernel(relief, shape)

    def gather(values: Array) -> Array:
        return (down.T @ values.reshape(rows, cols) @ across).ravel()

    area = cell / relief.cosine
    patch_area = gather(area)
    # Patches that overlap have other areas than those of the kernel's own points.
    kernel = limit_kernel(kernel, patch_area)
    effects = []
    for column, tint in zip(albedo.T, tints, strict=True):
        patch_albedo = gather(area * column.reshape(rows, cols)) / patch_area
        exchange = cell * solve_exchange(kernel, patch_area, patch_albedo)
        effects.append(Radiosity(name, (rows, cols), column, exchange, down, across, tint=tint))
    return tuple(effects)


def make_hat_weights(cells: int, patches: int) -> Array:
    """Return weights (cells, patches) of linear interpolation; each row sums to 1.

    Beyond the centre of the first and the last patch the nearest patch holds alone.
    """
    place = (np.arange(cells) + 0.5) * patches / cells - 0.5
    place = np.clip(place, 0.0, patches - 1.0)
    return np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(patches)))


def solve_exchange(kernel: Array, area: Array, albedo: Array) -> Array:
    """Return ``X = (1 - K A R)^-1 K`` (p, p), the sum over all bounces, by one direct solve.

    Row sums of ``K A`` are at most 1 (see `limit_kernel`) and albedos below 1, so the matrix is
    strictly diagonally dominant by rows and the solve is stable up to albedo 0.999 and beyond,
    where a sum over bounces would need thousands of terms.
    """
    system = np.eye(len(area)) - kernel * (area * albedo)
    exchange = np.linalg.solve(system, kernel)
    # Symmetric in exact arithmetic; made so to the last bit for reversible paths.
    return np.asarray(0.5 * (exchange + exchange.T))


def compute_form_kernel(relief: Relief, shape: tuple[int, int]) -> Array:
    """Return K (p, p), symmetric: form factor over area between all pairs of patches.

    ``K = cos cos / (pi d^2)``, averaged over 2 x 2 points of either patch. The area of a point is
    added to ``pi d^2`` (a disc in place of a point), which bounds it where two surfaces meet.
    Pairs that are hidden from each other exchange nothing. Rows with ``sum K A > 1``, an error of
    the coarse points, are scaled down from both sides.
    """
    rows, cols = relief.height.shape
    y = ((np.arange(2 * shape[0]) + 0.5) * rows / (2 * shape[0])).astype(int)
    x = ((np.arange(2 * shape[1]) + 0.5) * cols / (2 * shape[1])).astype(int)
    points = relief.points[np.ix_(y, x)].reshape(-1, 3)
    normals = relief.normals[np.ix_(y, x)].reshape(-1, 3)
    cell = relief.pitch[0] * relief.pitch[1]
    area = (cell / relief.cosine[np.ix_(y, x)]).ravel() * (rows * cols / points.shape[0])

    leaving = normals @ points.T - np.sum(normals * points, axis=1)[:, None]
    facing = np.maximum(leaving, 0.0)
    facing *= facing.T > 0.0
    first, second = np.nonzero(np.triu(facing))
    hidden = ~find_clear_pairs(relief, points[first], points[second])
    facing[first[hidden], second[hidden]] = 0.0
    square = np.sum((points[:, None] - points[None]) ** 2, axis=-1)
    mean_area = np.sqrt(area[:, None] * area)
    # Both cosines carry a factor d; the tiny term only keeps a point apart from itself.
    fine = facing * facing.T / (np.maximum(square, 1e-30) * (np.pi * square + mean_area))

    size = 2 * shape[1]
    split = fine.reshape(shape[0], 2, shape[1], 2, shape[0], 2, shape[1], 2)
    kernel = split.mean(axis=(1, 3, 5, 7)).reshape(shape[0] * shape[1], -1)
    patch_area = area.reshape(shape[0], 2, size).sum(axis=1).reshape(-1, 2).sum(axis=1)
    return limit_kernel(kernel, patch_area)


def limit_kernel(kernel: Array, area: Array) -> Array:
    """Return K (p, p) with rows of ``sum K A > 1`` scaled down from both sides: no patch receives
    more than all light. `area` (p,) is A."""
    scale = 1.0 / np.maximum(1.0, kernel @ area)
    scaled: Array = scale[:, None] * kernel * scale
    return scaled


def find_clear_pairs(relief: Relief, start: Array, end: Array) -> NDArray[np.bool_]:
    """Return whether the surface leaves the line from `start` to `end` free, for s pairs, (s,).

    `start`, `end` (s, 3) are points of the surface; the line is compared with the surface, linear
    between cells, at `_STEPS` places.
    """
    pitch = np.asarray(relief.pitch)
    # A line that just grazes the surface counts as clear: it is seldom wholly hidden.
    slack = 0.1 * float(pitch.max())
    clear = np.ones(len(start), dtype=np.bool_)
    for part in (np.arange(_STEPS) + 0.5) / _STEPS:
        line = start + part * (end - start)
        ground = _bilinear(relief.height, line[:, 1] / pitch[0], line[:, 0] / pitch[1])
        clear &= ground <= line[:, 2] + slack
    return clear


def _bilinear(field: Array, row: Array, col: Array) -> Array:
    """Return a field (rows, cols) between its cells, the border continued outwards, (s,)."""
    row = np.clip(row, 0.0, field.shape[0] - 1.0)
    col = np.clip(col, 0.0, field.shape[1] - 1.0)
    top = np.minimum(row.astype(np.int64), max(field.shape[0] - 2, 0))
    left = np.minimum(col.astype(np.int64), max(field.shape[1] - 2, 0))
    down = np.minimum(top + 1, field.shape[0] - 1)
    right = np.minimum(left + 1, field.shape[1] - 1)
    y, x = row - top, col - left
    upper = (1.0 - x) * field[top, left] + x * field[top, right]
    lower = (1.0 - x) * field[down, left] + x * field[down, right]
    mixed: Array = (1.0 - y) * upper + y * lower
    return mixed
