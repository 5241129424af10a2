"""What an off-axis rig sees of surfaces in space: displaced direct light, shadows, radiosity.

The projector stands at the origin, the camera `baseline` to its right; both look along z, and their
pictures are rectified: rows of cells are epipolar lines. Both fields are drawn so that a wall at
the distance `PLANE` has no disparity; the field is `FIELD_WIDTH` x `FIELD_HEIGHT` there. A point at
the distance z that the camera sees at x of the field is lit from

    x + baseline (PLANE / z - 1)            (rows are the same)

so that nearer things have their light from further right. Each cell is looked at along the ray of
its centre: it sees the first surface that this meets, and has direct light unless another surface
lies between that point and the projector.

Units: 1 is a white, fully lit, facing matte surface at `PLANE`. Every projector cell sends the same
flux, so light on a surface falls with the square of its distance and with its slope.

Light that surfaces throw at each other goes from patch to patch, every number of bounces at once
(`pdcd.virtual.scene.radiosity.solve_exchange`), and is linear between the centres of patches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdcd.virtual.scene.displaced import make_displaced_effects
from pdcd.virtual.scene.effects import COLOUR_NAMES, Array, Effect, LowRankEffect
from pdcd.virtual.scene.radiosity import limit_kernel, solve_exchange
from pdcd.virtual.scene.scene import Scene
from pdcd.virtual.scene.solids import Rectangle, find_clear_lines, find_first_hit
from pdcd.virtual.scene.texture import Drawing

FIELD_WIDTH, FIELD_HEIGHT = 4.0 / 3.0, 1.0
PLANE = 2.0
"""Distance at which there is no disparity."""
_PATCHES = 4
"""Patches along either edge of a surface; light between matte surfaces is smooth."""


@dataclass(frozen=True)
class OffAxisRig:
    """A rectified rig in front of surfaces: `grid` (rows, cols) cells of both devices."""

    grid: tuple[int, int]
    baseline: float
    surfaces: tuple[Rectangle, ...]

    def disparity_cells(self, z: float) -> float:
        """Cells right from where the camera sees a point at the distance z to its light."""
        return self.baseline * (PLANE / z - 1.0) * self.grid[1] / FIELD_WIDTH

    def distance(self, disparity_cells: float) -> float:
        """The distance that has this disparity."""
        return PLANE / (1.0 + disparity_cells * FIELD_WIDTH / (self.baseline * self.grid[1]))

    @cached_property
    def field(self) -> Array:
        """Centres of the cells on the wall at `PLANE`, (N, 3)."""
        rows, cols = self.grid
        y, x = np.meshgrid(
            ((np.arange(rows) + 0.5) / rows - 0.5) * FIELD_HEIGHT,
            ((np.arange(cols) + 0.5) / cols - 0.5) * FIELD_WIDTH,
            indexing="ij",
        )
        return np.stack([x.ravel(), y.ravel(), np.full(x.size, PLANE)], axis=1)

    @cached_property
    def seen(self) -> tuple[NDArray[np.int64], Array]:
        """What each camera cell sees: its surface (N,), -1 for none, and the point (N, 3)."""
        eye = np.array([self.baseline, 0.0, 0.0])
        return find_first_hit(self.surfaces, eye, self.field - eye)

    @cached_property
    def lit(self) -> tuple[NDArray[np.int64], Array]:
        """What each projector cell lights: its surface and the point, as `seen`."""
        return find_first_hit(self.surfaces, np.zeros(3), self.field)

    @cached_property
    def displacement(self) -> Array:
        """Cells (down, right) to where each camera cell's light comes from, (N, 2); NaN where it
        sees nothing, its point lies in shadow, or its light would come from beyond the field."""
        which, points = self.seen
        there = np.flatnonzero(which >= 0)
        moved = np.full((len(points), 2), np.nan)
        z = points[there, 2]
        right = self.baseline * (PLANE / z - 1.0) * self.grid[1] / FIELD_WIDTH
        bright = find_clear_lines(self.surfaces, np.zeros((len(there), 3)), points[there])
        place = there % self.grid[1] + 0.5 + right
        bright &= (place > 0.0) & (place < self.grid[1])
        moved[there[bright], 0], moved[there[bright], 1] = 0.0, right[bright]
        return moved

    @cached_property
    def albedo(self) -> Array:
        """Reflectance of what each camera cell sees, (N, 3); 0 where that is nothing."""
        which, _ = self.seen
        table = np.array([one.albedo for one in self.surfaces] + [(0.0, 0.0, 0.0)])
        return np.asarray(table[which])

    @cached_property
    def facing(self) -> Array:
        """Light that full projection brings to what each camera cell sees, (N,), shadow or not:
        the cosine of its angle over the square of the distance, 1 at the middle of `PLANE`."""
        which, points = self.seen
        normals = np.array([one.normal for one in self.surfaces])[which]
        square = np.sum(points**2, axis=1)
        cosine = np.abs(np.sum(normals * points, axis=1)) / np.sqrt(square)
        return np.where(which >= 0, np.nan_to_num(cosine * PLANE**2 / square), 0.0)


def build_off_axis_scene(name: str, rig: OffAxisRig, paint: Paint | None = None) -> Scene:
    """Return the scene that an off-axis rig sees."""
    direct = rig.albedo * rig.facing[:, None]
    painted = 1.0 if paint is None else paint.cells
    effects: tuple[Effect, ...] = (
        *make_displaced_effects(rig.grid, direct * painted, rig.displacement),
        *make_surface_effects(rig, painted),
    )
    if paint is None:
        return Scene(name, rig.grid, effects)
    return Scene(name, rig.grid, effects, None, paint.direct, paint.indirect)


def make_surface_effects(
    rig: OffAxisRig, painted: Array | float = 1.0
) -> tuple[LowRankEffect, ...]:
    """Return the light between surfaces, one effect a colour; its rank is the number of patches.

    painted : what paint lets through of the light of each camera cell, (N, 1) or 1.
    """
    patches = _Patches(rig.surfaces)
    kernel = limit_kernel(patches.kernel, patches.area)
    onto, seen = patches.weights(*rig.lit), patches.weights(*rig.seen)
    # Flux of a projector cell: that of a facing white cell at the plane.
    flux = FIELD_WIDTH * FIELD_HEIGHT / (rig.grid[0] * rig.grid[1])
    effects = []
    for channel, colour in enumerate(COLOUR_NAMES):
        table = np.array([one.albedo[channel] for one in rig.surfaces] + [0.0])
        exchange = solve_exchange(kernel, patches.area, table[patches.surface])
        leaving = flux * table[rig.lit[0]][:, None] * onto
        arriving = painted * table[rig.seen[0]][:, None] * (seen @ exchange)
        name = f"between surfaces, {colour}"
        effects.append(LowRankEffect(name, arriving, leaving, tint=np.eye(3)[channel]))
    return tuple(effects)


@dataclass(frozen=True, eq=False)
class Paint:
    """A pattern on surfaces: the share of the light of cells that it leaves (N, 1), and the detail
    of direct and of indirect light (`pdcd.virtual.scene.texture`). Light between surfaces ignores
    the pattern."""

    cells: Array
    direct: Drawing
    indirect: Drawing


@dataclass(frozen=True)
class _Patches:
    """All surfaces, cut into `_PATCHES` x `_PATCHES` each; P in all."""

    surfaces: Sequence[Rectangle]

    @property
    def surface(self) -> NDArray[np.int64]:
        """Surface of each patch, (P,)."""
        return np.repeat(np.arange(len(self.surfaces)), _PATCHES**2)

    @property
    def area(self) -> Array:
        """Areas, (P,)."""
        return np.repeat([one.area / _PATCHES**2 for one in self.surfaces], _PATCHES**2)

    @property
    def centres(self) -> Array:
        """Centres, (P, 3)."""
        step = (np.arange(_PATCHES) + 0.5) / _PATCHES
        down, across = (v.ravel()[:, None] for v in np.meshgrid(step, step, indexing="ij"))
        corner, right, below = (
            np.repeat([getattr(one, name) for one in self.surfaces], _PATCHES**2, axis=0)
            for name in ("corner", "across", "down")
        )
        across, down = (np.tile(v, (len(self.surfaces), 1)) for v in (across, down))
        return np.asarray(corner + across * right + down * below)

    @property
    def kernel(self) -> Array:
        """Form factor over area between all pairs of patches, (P, P), symmetric.

        ``cos cos / (pi d^2)``, with the mean area added to ``pi d^2`` (a disc in place of a point);
        0 where a surface lies between, and where one patch lies behind the other: surfaces shine to
        the side that the rig sees.
        """
        points, area = self.centres, self.area
        normals = np.array([self._towards_rig(k) for k in range(len(self.surfaces))])[self.surface]
        way = points[None, :, :] - points[:, None, :]
        square = np.sum(way**2, axis=-1)
        leaving = np.maximum(np.einsum("ik,ijk->ij", normals, way), 0.0)
        facing = leaving * leaving.T
        first, second = np.nonzero(np.triu(facing))
        hidden = ~find_clear_lines(self.surfaces, points[first], points[second])
        facing[first[hidden], second[hidden]] = facing[second[hidden], first[hidden]] = 0.0
        mean_area = np.sqrt(area[:, None] * area)
        kernel: Array = facing / (np.maximum(square, 1e-30) * (np.pi * square + mean_area))
        return kernel

    def _towards_rig(self, number: int) -> Array:
        """The normal of a surface that points to the projector's side."""
        one = self.surfaces[number]
        centre = np.asarray(one.corner) + 0.5 * (np.asarray(one.across) + np.asarray(one.down))
        return one.normal if one.normal @ centre < 0.0 else -one.normal

    def weights(self, which: NDArray[np.int64], points: Array) -> Array:
        """How much each patch counts at points (n, 3) of surfaces (n,), (n, P): linear between the
        centres of patches of one surface; 0 for points of none."""
        found = np.zeros((len(which), len(self.surfaces) * _PATCHES**2))
        for number, one in enumerate(self.surfaces):
            mine = np.flatnonzero(which == number)
            u, v = one.place(points[mine])
            across, down = _hats(u), _hats(v)
            columns = slice(number * _PATCHES**2, (number + 1) * _PATCHES**2)
            both = down[:, :, None] * across[:, None, :]
            found[mine, columns] = both.reshape(len(mine), _PATCHES**2)
        return found


def _hats(place: Array) -> Array:
    """Weights (n, PATCHES) of the patches along an edge at places 0 to 1."""
    where = np.clip(place * _PATCHES - 0.5, 0.0, _PATCHES - 1.0)
    return np.maximum(0.0, 1.0 - np.abs(where[:, None] - np.arange(_PATCHES)))
