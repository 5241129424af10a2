"""Scenes: what each point sends back of the light on it, and by which ways light gets there.

Light leaves a point by its albedo. It came straight from the projector; or through the stone from
a point nearby (`marble`), or off a polished facet from one point far away (`mirror`): then it is a
*strand* from one point to another; or off another part of a folded sheet (`fold`), which is smooth:
then it goes from *tents* of points to others, by a table of what one part sees of another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TENTS = (3, 4)
"""Rows and columns of tents over the scene."""


@dataclass(frozen=True, eq=False)
class Strands:
    """Light from points to points.

    index : (n,) which of the points asked about get it.
    source : (n, 2) scene points that it comes from.
    weight : (n,) of the light there.
    """

    index: NDArray[np.int64]
    source: Floats
    weight: Floats


class Scene:
    """What stands before the bench; points are in pixels of the projector."""

    def __init__(self, name: str, seed: int, size_px: tuple[int, int]) -> None:
        """`name` "card" is a flat white card; the others are those of `facts.SCENES`."""
        self.name, self._size = name, np.array(size_px, dtype=np.float64)
        self._rng_seed = seed
        rng = np.random.default_rng([seed, 5])
        self._tiles = rng.uniform(0.25, 0.95, (11, 14))
        self._tints = 1.0 + 0.15 * rng.uniform(-1.0, 1.0, (5, 6, 3))
        rows, cols = TENTS
        self._sees = _facing(rows, cols) if name in ("fold", "relief") else None

    def albedo(self, points: Floats) -> Floats:
        """Of points (n, 2): (n, 3). Patches with soft edges, tinted."""
        if self.name == "card":
            return np.ones((len(points), 3))
        grey = _spread(self._tiles[..., None], points / self._size)
        grey = 0.35 * grey + 0.65 * np.round(grey * 4.0) / 4.0
        return np.asarray(grey * _spread(self._tints, points / self._size) * 0.85)

    def strands(self, points: Floats) -> Strands | None:
        """Single ways of light to points (n, 2), each with its own chance; None: there are none."""
        rng = np.random.default_rng([self._rng_seed, 6])
        if self.name in ("marble", "relief"):
            radius = np.where(rng.random(len(points)) < 0.5, 0.12, 0.28) * self._size[0]
            radius = radius * np.sqrt(-np.log(rng.uniform(1e-6, 1.0, len(points))))
            angle = rng.uniform(0.0, 2.0 * np.pi, len(points))
            source = points + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            share = 0.8 if self.name == "marble" else 0.3
            return Strands(np.arange(len(points)), source, np.full(len(points), share))
        if self.name == "mirror":
            at = points / self._size
            inside = (abs(at[:, 0] - 0.25) < 0.17) & (abs(at[:, 1] - 0.5) < 0.35)
            index = np.flatnonzero(inside)
            # A facet that stands askew: it shows the right half, mirrored and a little larger.
            seen = np.stack(
                [0.98 - 0.9 * at[index, 0] + 0.12 * at[index, 1], 0.06 + 0.92 * at[index, 1]], 1
            )
            source = seen * self._size + 0.4 * rng.standard_normal((len(index), 2))
            return Strands(index, source, np.full(len(index), 0.7))
        return None

    def tents(self, points: Floats) -> Floats:
        """How much each tent is of points (n, 2), (n, tents): they add up to one."""
        rows, cols = TENTS
        at = np.clip(points / self._size, 0.0, 1.0)
        x, y = at[:, 0] * (cols - 1), at[:, 1] * (rows - 1)
        across = np.maximum(0.0, 1.0 - abs(x[:, None] - np.arange(cols)))
        down = np.maximum(0.0, 1.0 - abs(y[:, None] - np.arange(rows)))
        return np.asarray((down[:, :, None] * across[:, None, :]).reshape(len(points), -1))

    @property
    def sees(self) -> Floats | None:
        """(tents, tents) light on one per light on another; None where no part sees another."""
        return self._sees


def _facing(rows: int, cols: int) -> Floats:
    """What parts of a sheet folded along its middle see of each other, by solid angle, with the
    light that goes to and fro three times."""
    x = np.tile(np.linspace(-1.0, 1.0, cols), rows)
    y = np.repeat(np.linspace(-0.75, 0.75, rows), cols)
    slope = np.deg2rad(38.0)
    place = np.stack([x, y, abs(x) * np.tan(slope)], axis=1)
    normal = np.stack(
        [-np.sign(x) * np.sin(slope), np.zeros_like(x), np.full_like(x, np.cos(slope))], 1
    )
    way = place[None, :, :] - place[:, None, :]
    far = np.sqrt(np.sum(way**2, axis=-1)) + 1e-9
    leaving = np.einsum("ijk,ik->ij", way, normal) / far
    coming = -np.einsum("ijk,jk->ij", way, normal) / far
    area = (2.0 / cols) * (1.5 / rows) / np.cos(slope)
    once = np.maximum(leaving, 0.0) * np.maximum(coming, 0.0) * area / (np.pi * far**2 + area)
    once = 1.6 * once
    return np.asarray(once + 0.5 * once @ once + 0.25 * once @ once @ once)


def _spread(table: Floats, at: Floats) -> Floats:
    """A table (rows, cols, C) spread over the scene, between its entries in straight lines."""
    rows, cols = table.shape[:2]
    x = np.clip(at[:, 0], 0.0, 1.0) * (cols - 1.001)
    y = np.clip(at[:, 1], 0.0, 1.0) * (rows - 1.001)
    i, j = y.astype(int), x.astype(int)
    u, v = (y - i)[:, None], (x - j)[:, None]
    upper = table[i, j] * (1.0 - v) + table[i, j + 1] * v
    lower = table[i + 1, j] * (1.0 - v) + table[i + 1, j + 1] * v
    return np.asarray(upper * (1.0 - u) + lower * u)
