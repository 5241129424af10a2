"""A ball covered with small flat mirrors, each glued a little askew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.presets.canvas import FrameRaster, Shape
from pdcd.virtual.scene.presets.thrown import Landing

FACET_REFLECTANCE = 0.85
"""Reflectance of a facet."""

_Plane = tuple[float, float, float]
"""A plane by its height at the middle of the frame and its rise to the right and down. A room is
the highest of its planes at each place: seen from within it bulges outwards everywhere."""


@dataclass(frozen=True)
class MirrorBall:
    """A mirror ball.

    centre : (x, y, height)
    radius : in the frame
    rings : rings of facets from pole to pole
    seed : sets how the facets were glued
    """

    centre: tuple[float, float, float]
    radius: float
    rings: int
    seed: int

    @cached_property
    def _ring_sizes(self) -> NDArray[np.intp]:
        """The number of facets in each ring, all round the ball, from pole to pole."""
        latitude = np.pi * ((np.arange(self.rings) + 0.5) / self.rings - 0.5)
        sizes: NDArray[np.intp] = np.rint(2 * self.rings * np.cos(latitude)).astype(np.intp)
        return sizes

    def along(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the place of points of the frame on the ball: along the rings of facets from pole
        to pole, and along the facets of a ring; a whole number is the edge of a facet."""
        across, down = (x - self.centre[0]) / self.radius, (y - self.centre[1]) / self.radius
        up = np.sqrt(np.maximum(1.0 - across**2 - down**2, 0.0))
        ring = (np.arcsin(np.clip(down, -1.0, 1.0)) / np.pi + 0.5) * self.rings
        size = self._ring_sizes[np.minimum(ring.astype(np.intp), self.rings - 1)]
        return ring, (np.arctan2(across, up) / (2 * np.pi) + 0.5) * size

    def facet(self, x: Array, y: Array) -> NDArray[np.intp]:
        """Return the number of the facet at places of the frame, -1 off the ball."""
        ring, place = self.along(x, y)
        first = np.concatenate(([0], np.cumsum(self._ring_sizes)[:-1]))
        number: NDArray[np.intp] = first[np.minimum(ring.astype(np.intp), self.rings - 1)]
        number = number + place.astype(np.intp)
        across, down = (x - self.centre[0]) / self.radius, (y - self.centre[1]) / self.radius
        on_ball = across**2 + down**2 < 1.0
        return np.where(on_ball, number, np.intp(-1))

    @cached_property
    def facets(self) -> tuple[Array, Array]:
        """The normals (facets, 3), and the share that each facet sends straight back (facets,)."""
        rng = np.random.default_rng(self.seed)
        normals = self._normals(rng)
        # A facet sends light straight back only when it faces the camera; else it is nearly black.
        facing = np.exp(-(((1.0 - normals[:, 2]) / 0.02) ** 2))
        return normals, 0.02 + 0.16 * rng.random(len(normals)) ** 2 + 0.70 * facing

    def _normals(self, rng: np.random.Generator) -> Array:
        """Return the normals (facets, 3) of the facets, each glued a little askew."""
        sizes = self._ring_sizes
        ring = np.repeat(np.arange(self.rings), sizes)
        place = np.concatenate([(np.arange(size) + 0.5) / size for size in sizes])
        latitude = np.pi * ((ring + 0.5) / self.rings - 0.5) + rng.normal(0.0, 0.03, ring.size)
        longitude = 2 * np.pi * (place - 0.5) + rng.normal(0.0, 0.03, ring.size)
        flat = np.cos(latitude)
        return np.stack(
            [flat * np.sin(longitude), np.sin(latitude), flat * np.cos(longitude)], axis=-1
        )

    @property
    def rays(self) -> Array:
        """Where each facet sends the light that falls on it, (facets, 3)."""
        normals, _ = self.facets
        ray: Array = 2.0 * normals[:, 2:] * normals - np.array([0.0, 0.0, 1.0])
        return ray

    def points(self, x: Array, y: Array) -> Array:
        """Return the points (s, 3) of the ball that are seen at places (s,) on it."""
        across, down = x - self.centre[0], y - self.centre[1]
        up = np.sqrt(self.radius**2 - across**2 - down**2)
        return np.stack([x, y, self.centre[2] + up], axis=-1)

    @property
    def middles(self) -> Array:
        """The middles of the facets, (facets, 3)."""
        middles: Array = np.array([*self.centre]) + self.radius * self.facets[0]
        return middles

    def draw(self, raster: FrameRaster, image: Array, facets: Array) -> None:
        """Draw the ball over an image in detail; its facets have the values `facets` (facets,)."""
        ring, place = self.along(raster.x, raster.y)
        facet = self.facet(raster.x, raster.y)
        ball = facet >= 0
        across, down = place[ball] % 1.0 - 0.5, ring[ball] % 1.0 - 0.5
        # Facets are a little hollow, so each glints most at one spot, and the glue between is dark.
        spot = 0.6 + 1.2 * np.exp(-((across + 0.1) ** 2 + (down + 0.15) ** 2) / 0.06)
        glue = np.maximum(np.abs(across), np.abs(down)) > 0.45
        image[ball] = (facets[facet[ball]] * np.where(glue, 0.15, spot))[:, None]

    def lands(self, room: Sequence[_Plane]) -> Landing:
        """Return where the ball's light lands in a room of planes, see `thrown.Landing`."""

        def landing(x: Array, y: Array) -> tuple[Shape, Array, Array]:
            facet = self.facet(x, y)
            ball = facet >= 0
            to_x, to_y = np.zeros(x.shape), np.zeros(x.shape)
            start = self.points(x[ball], y[ball])
            to_x[ball], to_y[ball] = find_ray_ends(room, start, self.rays[facet[ball]])
            there = ball & np.isfinite(to_x)
            # Spots behind the ball are not seen.
            there &= self.facet(np.where(there, to_x, 0.0), np.where(there, to_y, 0.0)) < 0
            return there, to_x, to_y

        return landing


def find_ray_ends(room: Sequence[_Plane], start: Array, ray: Array) -> tuple[Array, Array]:
    """Return where rays (s, 3) from points (s, 3) meet a room: x, y, infinite if nowhere."""
    far = np.full(len(ray), np.inf)
    for height, right, down in room:
        above = start[:, 2] - height - right * start[:, 0] - down * start[:, 1]
        falls = right * ray[:, 0] + down * ray[:, 1] - ray[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            here = np.where(falls > 0.0, np.maximum(above, 0.0) / falls, np.inf)
        far = np.minimum(far, here)
    with np.errstate(invalid="ignore"):
        end = start + far[:, None] * ray
    gone = ~np.isfinite(far)
    end[gone] = np.inf
    return end[:, 0], end[:, 1]
