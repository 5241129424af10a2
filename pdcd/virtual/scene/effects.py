"""Light transport as a sum of effects, each stored in the cheapest form it has.

A scene of N cells has a transport matrix T (N, N): row n is what the camera sees at cell n when
each projector cell m is lit alone. T is never stored whole; it is a sum of effects, and each
effect knows three things about its own share T_e:

- `apply`: what comes back when the scene is lit, ``T_e x``;
- `probe`: what one exposure with changing projector and mask patterns collects, which is the
  row sum of ``(left^T right) o T_e`` (equations 2 and 5 of the paper, with the realised matrix
  given as a sum of R rank-1 terms);
- `diagonal`: the share that comes back at the cell it fell on.

Arrays are float64. Cells are row-major, so N = rows * cols and a batch of B illuminations is
(B, N). Values are in scene units: 1 is a white, fully lit, facing matte surface.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

COLOUR_NAMES = ("red", "green", "blue")
"""Names of the channels, in their order."""


class Effect(Protocol):
    """One share of the light transport; see the module for shapes and units."""

    @property
    def name(self) -> str:
        """What the effect is, for people."""
        ...

    @property
    def coaxial(self) -> bool:
        """True when light comes back at the very point it fell on (direct reflection).

        Such light crosses the projector's and the mask's patterns at the same point, so it sees
        their structure below the size of a cell; all other light is blurred over whole cells.
        """
        ...

    @property
    def tint(self) -> Array:
        """(3,) factors for R, G, B."""
        ...

    def apply(self, light: Array) -> Array:
        """Return ``T_e x`` (B, N) for each row x of `light` (B, N); the tint is left out."""
        ...

    def probe(self, left: Array, right: Array) -> Array:
        """Return ``sum_r left_r * (T_e right_r)`` (N,) for `left`, `right` of shape (R, N)."""
        ...

    def diagonal(self) -> Array:
        """Return the diagonal of ``T_e`` (N,)."""
        ...

    def entries(self, seen: Cells, lit: Cells) -> Array:
        """Return the entries of ``T_e`` from cells `lit` to cells `seen`, (P,) each."""
        ...

    def dense(self) -> Array:
        """Return ``T_e`` (N, N); for small grids only."""
        ...


def make_tint(red: float, green: float, blue: float) -> Array:
    """Return a tint (3,) float64."""
    return np.array([red, green, blue], dtype=np.float64)


def sum_products(left: Array, right: Array) -> Array:
    """Return ``sum_r left_rn right_rn`` (N,) of two (R, N) arrays, without a temporary."""
    total: Array = np.einsum("rn,rn->n", left, right)
    return total


@dataclass(frozen=True, eq=False)
class TintedEffect:
    """What all effects share: a name, a tint (3,), and light that forgets its exact point."""

    name: str
    tint: Array = field(default_factory=lambda: np.ones(3), kw_only=True)

    @property
    def coaxial(self) -> bool:
        """False: the light travels before it comes back."""
        return False


@dataclass(frozen=True, eq=False)
class DirectEffect(TintedEffect):
    """Light that comes back where it fell: a diagonal, `albedo` (N,)."""

    albedo: Array

    @property
    def coaxial(self) -> bool:
        """True: this is the direct reflection."""
        return True

    def apply(self, light: Array) -> Array:
        """See `Effect.apply`."""
        return light * self.albedo

    def probe(self, left: Array, right: Array) -> Array:
        """See `Effect.probe`."""
        return self.albedo * sum_products(left, right)

    def diagonal(self) -> Array:
        """See `Effect.diagonal`."""
        return self.albedo.copy()

    def entries(self, seen: Cells, lit: Cells) -> Array:
        """See `Effect.entries`."""
        return np.where(seen == lit, self.albedo[seen], 0.0)

    def dense(self) -> Array:
        """See `Effect.dense`."""
        return np.diag(self.albedo)


def make_direct_effects(albedo: Array) -> tuple[DirectEffect, ...]:
    """Return direct reflection with a colour of its own at each cell, `albedo` (N, 3)."""
    return tuple(
        DirectEffect(f"direct {colour}", albedo[:, channel], tint=np.eye(3)[channel])
        for channel, colour in enumerate(COLOUR_NAMES)
    )


@dataclass(frozen=True, eq=False)
class LowRankEffect(TintedEffect):
    """Light that passes through few states: ``T = A B^T`` with `a`, `b` of shape (N, r)."""

    a: Array
    b: Array

    def apply(self, light: Array) -> Array:
        """See `Effect.apply`."""
        return (light @ self.b) @ self.a.T

    def probe(self, left: Array, right: Array) -> Array:
        """See `Effect.probe`; summing over R first leaves (N, r) work, not (R, N)."""
        seen: Array = (self.a * (left.T @ (right @ self.b))).sum(axis=1)
        return seen

    def diagonal(self) -> Array:
        """See `Effect.diagonal`."""
        diagonal: Array = (self.a * self.b).sum(axis=1)
        return diagonal

    def entries(self, seen: Cells, lit: Cells) -> Array:
        """See `Effect.entries`."""
        return sum_products(self.a[seen].T, self.b[lit].T)

    def dense(self) -> Array:
        """See `Effect.dense`."""
        return self.a @ self.b.T


@dataclass(frozen=True, eq=False)
class SparseEffect(TintedEffect):
    """Few single paths, as mirrors and caustics make them: a CSR `matrix` (N, N)."""

    matrix: Any

    @cached_property
    def _rows(self) -> NDArray[np.intp]:
        """Cells that any path reaches."""
        return np.flatnonzero(np.diff(self.matrix.indptr))

    @cached_property
    def _cols(self) -> NDArray[np.intp]:
        """Cells that any path starts from."""
        return np.unique(self.matrix.indices).astype(np.intp)

    @cached_property
    def _core(self) -> Any:
        """The matrix without its empty rows and columns, so that work is done for paths only."""
        return self.matrix[self._rows][:, self._cols]

    def _arriving(self, light: Array) -> Array:
        arriving: Array = np.asarray(self._core @ light[:, self._cols].T).T
        return arriving

    def apply(self, light: Array) -> Array:
        """See `Effect.apply`."""
        out = np.zeros_like(light)
        out[:, self._rows] = self._arriving(light)
        return out

    def probe(self, left: Array, right: Array) -> Array:
        """See `Effect.probe`."""
        out = np.zeros(left.shape[1])
        out[self._rows] = sum_products(left[:, self._rows], self._arriving(right))
        return out

    def diagonal(self) -> Array:
        """See `Effect.diagonal`."""
        return np.asarray(self.matrix.diagonal(), dtype=np.float64)

    def entries(self, seen: Cells, lit: Cells) -> Array:
        """See `Effect.entries`."""
        return np.asarray(self.matrix[seen, lit], dtype=np.float64).ravel()

    def dense(self) -> Array:
        """See `Effect.dense`."""
        return np.asarray(self.matrix.toarray(), dtype=np.float64)


def make_two_way_paths(name: str, one_way: Any, tint: Array) -> SparseEffect:
    """Return the paths of `one_way`, a sparse (N, N), together with their reverses."""
    return SparseEffect(name, scipy.sparse.csr_array(one_way + one_way.T), tint=tint)


@dataclass(frozen=True, eq=False)
class DenseEffect(TintedEffect):
    """Transport without any known form: the whole `matrix` (N, N)."""

    matrix: Array

    def apply(self, light: Array) -> Array:
        """See `Effect.apply`."""
        return light @ self.matrix.T

    def probe(self, left: Array, right: Array) -> Array:
        """See `Effect.probe`."""
        return sum_products(left, self.apply(right))

    def diagonal(self) -> Array:
        """See `Effect.diagonal`."""
        return np.diagonal(self.matrix).copy()

    def entries(self, seen: Cells, lit: Cells) -> Array:
        """See `Effect.entries`."""
        return np.asarray(self.matrix[seen, lit])

    def dense(self) -> Array:
        """See `Effect.dense`."""
        return self.matrix.copy()
