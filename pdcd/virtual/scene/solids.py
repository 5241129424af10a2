"""Flat surfaces in space, and where straight lines meet them, in closed form.

Points are (x, y, z): right, down, away from the rig. A surface is a rectangle with two sides; a box
is the five faces that a rig in front of it can see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdcd.virtual.scene.effects import Array

_Colour = tuple[float, float, float]

_NEAR = 1e-9
"""A surface met within this share of the way from a point does not count: it is the point's own."""


@dataclass(frozen=True)
class Rectangle:
    """A matte rectangle: `corner` and two edges at right angles, (3,) each; `albedo` below 1."""

    corner: tuple[float, float, float]
    across: tuple[float, float, float]
    down: tuple[float, float, float]
    albedo: _Colour

    @cached_property
    def normal(self) -> Array:
        """A unit normal, (3,), to either side."""
        cross = np.cross(self.across, self.down)
        unit: Array = cross / np.linalg.norm(cross)
        return unit

    @property
    def area(self) -> float:
        """Area of one side."""
        return float(np.linalg.norm(np.cross(self.across, self.down)))

    def place(self, points: Array) -> tuple[Array, Array]:
        """Where points of its plane (..., 3) lie along both edges, 0 to 1 inside."""
        off = points - np.asarray(self.corner)
        u, v = (off @ np.asarray(edge) / np.dot(edge, edge) for edge in (self.across, self.down))
        return u, v

    def met(self, start: Array, way: Array) -> Array:
        """How far along `way` lines from `start` (..., 3) meet it, in multiples of `way`; infinite
        where they never do.

        A line that runs within the plane of the rectangle does not meet it.
        """
        against = way @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (np.asarray(self.corner) - start) @ self.normal / against
        found = (against != 0.0) & (far > _NEAR)
        far = np.where(found, far, 0.0)
        u, v = self.place(start + far[..., None] * way)
        inside = found & (u >= 0.0) & (u <= 1.0) & (v >= 0.0) & (v <= 1.0)
        return np.where(inside, far, np.inf)


def make_wall(z: float, half: tuple[float, float], albedo: _Colour) -> Rectangle:
    """A wall square to the rig's axis, at distance z, `half` (width, height) to either side."""
    width, height = half
    return Rectangle(
        (-width, -height, z), (2.0 * width, 0.0, 0.0), (0.0, 2.0 * height, 0.0), albedo
    )


def make_box(
    low: tuple[float, float, float], high: tuple[float, float, float], albedo: _Colour
) -> tuple[Rectangle, ...]:
    """The faces of a box but for the back one; the front comes first."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    wide, tall, deep = (x1 - x0, 0.0, 0.0), (0.0, y1 - y0, 0.0), (0.0, 0.0, z1 - z0)
    return (
        Rectangle((x0, y0, z0), wide, tall, albedo),
        Rectangle((x0, y0, z0), deep, tall, albedo),
        Rectangle((x1, y0, z0), deep, tall, albedo),
        Rectangle((x0, y0, z0), wide, deep, albedo),
        Rectangle((x0, y1, z0), wide, deep, albedo),
    )


def find_first_hit(
    surfaces: Sequence[Rectangle], start: Array, way: Array
) -> tuple[NDArray[np.int64], Array]:
    """Which surface lines from `start` (3,) or (n, 3) along `way` (n, 3) meet first, and where.

    Returns
    -------
    which : (n,) int64, -1 where none is met.
    points : (n, 3), NaN there.
    """
    begin = np.broadcast_to(start, way.shape)
    far = np.stack([one.met(begin, way) for one in surfaces])
    which = far.argmin(axis=0)
    nearest = far.min(axis=0)
    there = np.isfinite(nearest)
    points = np.where(there[:, None], begin + np.where(there, nearest, 0.0)[:, None] * way, np.nan)
    return np.where(there, which, -1), points


def find_clear_lines(surfaces: Sequence[Rectangle], start: Array, end: Array) -> NDArray[np.bool_]:
    """Whether nothing lies between points `start` and `end`, (n, 3) each; (n,).

    Surfaces on which either point lies do not count.
    """
    way = end - start
    free = np.ones(len(way), dtype=np.bool_)
    for one in surfaces:
        far = one.met(start, way)
        free &= ~((far > 1e-6) & (far < 1.0 - 1e-6))
    return free
