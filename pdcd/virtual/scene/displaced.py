"""Direct light on an off-axis bench: it comes back beside the cell it was sent from.

The camera sees at cell n a point that the projector lights from the place n + displacement_n, in
cells, which need not be whole. Within a cell the displacement is one number, so a camera cell takes
its light from at most 2 x 2 projector cells, by the shares of them that it covers::

    T_nm = albedo_n * share of cell n, moved by its displacement, that lies in cell m

That is exact where panels show whole cells. Windows that open parts of cells are looked at part by
part (`pdcd.probing.fine`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.virtual.scene.effects import (
    COLOUR_NAMES,
    Array,
    Cells,
    Effect,
    TintedEffect,
    sum_products,
)

_Grid = tuple[int, int]


@dataclass(frozen=True, eq=False)
class DisplacedEffect(TintedEffect):
    """Direct reflection, `albedo` (N,), of light from elsewhere.

    grid : (rows, cols)
    displacement : (N, 2) float64
        Cells down and right from each camera cell to where its light comes from; NaN where none
        arrives, as in shadow.
    """

    grid: _Grid
    albedo: Array
    displacement: Array

    @cached_property
    def _paths(self) -> Any:
        """Share of each projector cell in each camera cell's light, CSR (N, N)."""
        return compute_displaced_shares(self.grid, self.displacement)

    def apply(self, light: Array) -> Array:
        """See `Effect.apply`."""
        return np.asarray(self._paths @ light.T).T * self.albedo

    def probe(self, left: Array, right: Array) -> Array:
        """See `Effect.probe`."""
        return sum_products(left, self.apply(right))

    def diagonal(self) -> Array:
        """See `Effect.diagonal`."""
        return np.asarray(self._paths.diagonal() * self.albedo)

    def entries(self, seen: Cells, lit: Cells) -> Array:
        """See `Effect.entries`."""
        return np.asarray(self._paths[seen, lit]).ravel() * self.albedo[seen]

    def dense(self) -> Array:
        """See `Effect.dense`."""
        return np.asarray(self._paths.toarray()) * self.albedo[:, None]


def make_displaced_effects(
    grid: _Grid, albedo: Array, displacement: Array
) -> tuple[DisplacedEffect, ...]:
    """Return displaced reflection with a colour of its own at each cell, `albedo` (N, 3)."""
    return tuple(
        DisplacedEffect(
            f"direct {colour}", grid, albedo[:, channel], displacement, tint=np.eye(3)[channel]
        )
        for channel, colour in enumerate(COLOUR_NAMES)
    )


def compute_displaced_shares(grid: _Grid, displacement: Array) -> Any:
    """Return how much of each cell, moved by its displacement (N, 2), lies in each: CSR (N, N).

    Rows sum to 1 but for what lies beyond the grid; rows of NaN are empty.
    """
    rows, cols = grid
    there = np.flatnonzero(np.isfinite(displacement).all(axis=1))
    moved = displacement[there]
    whole = np.floor(moved)
    part = moved - whole
    row, col = np.divmod(there, cols)
    camera: list[NDArray[np.int64]] = []
    projector: list[NDArray[np.int64]] = []
    share: list[Array] = []
    for down in (0, 1):
        for right in (0, 1):
            r = row + whole[:, 0].astype(np.int64) + down
            c = col + whole[:, 1].astype(np.int64) + right
            weight = np.abs(1.0 - down - part[:, 0]) * np.abs(1.0 - right - part[:, 1])
            kept = (r >= 0) & (r < rows) & (c >= 0) & (c < cols) & (weight > 0.0)
            camera.append(there[kept])
            projector.append((r * cols + c)[kept])
            share.append(weight[kept])
    place = np.concatenate(camera), np.concatenate(projector)
    size = rows * cols
    return scipy.sparse.csr_array((np.concatenate(share), place), shape=(size, size))


def is_single_bounce(effect: Effect) -> bool:
    """Whether light comes straight back from the surface that it fell on."""
    return effect.coaxial or isinstance(effect, DisplacedEffect)


def compute_direct_albedo(effects: Iterable[Effect], cells: int) -> Array:
    """Direct reflection of a scene's cells, (N, 3)."""
    found = np.zeros((cells, 3))
    for effect in effects:
        if isinstance(effect, DisplacedEffect):
            found += effect.albedo[:, None] * effect.tint
        elif effect.coaxial:
            found += effect.diagonal()[:, None] * effect.tint
    return found
