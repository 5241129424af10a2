"""A mirror ball in a corner: its facets throw spots of light onto walls and floor."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from pdcd.scene.effects import Array, both_ways, coloured_direct, rgb
from pdcd.scene.presets.canvas import HEIGHT, WIDTH, Canvas, Raster, seed_of
from pdcd.scene.presets.detail import DARKEST, PIXELS, detail, grain
from pdcd.scene.radiosity import Relief, radiosity
from pdcd.scene.scene import Scene

CENTRE = (0.0, -0.14, 0.10)
"""Of the ball (x, y, height)."""
RADIUS = 0.50
RINGS = 11
"""Rings of facets from pole to pole."""
MIRROR = 0.85
"""Reflectance of a facet."""
FLOOR_EDGE, SIDE_EDGE = 0.48, 0.98
"""Where the wall turns into the floor and into the side walls."""
WALL = -0.5
"""Height of the wall behind the ball."""
BUDGET = 0.35
"""Most that all spots on one cell may return together, so that no cell returns more than it got."""
STRIDE, STEPS = 0.01, 250
"""How finely, and how far, the light of a facet is followed."""


def disco_ball(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build a mirror ball that hangs in a room; `seed` sets how its facets were glued."""
    seed = seed_of("disco-ball", options)
    canvas = Canvas(grid)
    normals, glint = _facets(seed)
    facet = _facet(canvas.x, canvas.y)
    ball = facet >= 0

    relief = Relief(room_height(canvas.cell_x, canvas.cell_y), canvas.pitch)
    matte = canvas.cells(np.where(ball[..., None], 0.0, _room(canvas)))
    direct = matte * relief.cosine.reshape(-1, 1)
    direct += canvas.cells(np.where(ball, glint[facet], 0.0))[:, None]

    grey = matte.mean(axis=1)
    paths = _paths(canvas, normals, grey * relief.cosine.ravel())
    tint = rgb(1.0, 0.92, 0.84)
    return Scene(
        "disco-ball",
        grid,
        (
            *coloured_direct(direct),
            both_ways("spots", paths, tint),
            *radiosity("between the walls", relief, grey[:, None], [tint]),
        ),
        texture=partial(_texture, seed),
        indirect_texture=partial(_reflections, seed),
    )


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw in detail what returns at once."""
    raster = detail()
    image = _in_detail(raster, _facets(seed)[1])
    pitch = (1.0 / PIXELS, 1.0 / PIXELS)
    slope = Relief(room_height(raster.x, raster.y), pitch).cosine
    image *= np.where(_facet(raster.x, raster.y) < 0, slope, 1.0)[..., None]
    return np.maximum(image, DARKEST)


@lru_cache(maxsize=1)
def _reflections(seed: int) -> Array:
    """Draw in detail where indirect light comes from: the walls, and facets that show them."""
    normals, _ = _facets(seed)
    flat = np.concatenate([np.zeros((len(normals), 2)), np.ones((len(normals), 1))], axis=-1)
    ray = 2.0 * normals[:, 2:] * normals - flat
    x, y = _landing(np.array([*CENTRE[:2], CENTRE[2]]) + RADIUS * normals, ray)
    seen = (np.abs(x) < WIDTH / 2.0) & (np.abs(y) < HEIGHT / 2.0)
    seen[seen] = _facet(x[seen], y[seen]) < 0  # not what the ball itself hides
    return np.maximum(_in_detail(detail(), np.where(seen, 0.3, DARKEST)), DARKEST)


def _in_detail(raster: Raster, facets: Array) -> Array:
    """Draw the room and a ball whose facets (facets,) have these values."""
    image = _room(raster)
    floor = _floor_rise(raster.y) > _side_rise(raster.x)
    image *= np.where(floor, grain(0.10, along=24), grain(0.04))[..., None]
    ring, place = _rings(raster.x, raster.y)
    facet = _facet(raster.x, raster.y)
    ball = facet >= 0
    across, down = place[ball] % 1.0 - 0.5, ring[ball] % 1.0 - 0.5
    # Facets are a little hollow, so each glints most at one spot, and the glue between is dark.
    spot = 0.6 + 1.2 * np.exp(-((across + 0.1) ** 2 + (down + 0.15) ** 2) / 0.06)
    glue = np.maximum(np.abs(across), np.abs(down)) > 0.45
    image[ball] = (facets[facet[ball]] * np.where(glue, 0.15, spot))[:, None]
    return image


def room_height(x: Array, y: Array) -> Array:
    """Return the height of the wall, the floor and the side walls at places of the frame."""
    height: Array = WALL + np.maximum(_floor_rise(y), _side_rise(x))
    return height


def _floor_rise(y: Array) -> Array:
    rise: Array = 1.5 * np.maximum(y - FLOOR_EDGE, 0.0)
    return rise


def _side_rise(x: Array) -> Array:
    rise: Array = 1.8 * np.maximum(np.abs(x) - SIDE_EDGE, 0.0)
    return rise


def _room(raster: Raster) -> Array:
    """Return the colours of wall, floor boards and the thread that holds the ball."""
    image = raster.fill((0.56, 0.51, 0.46))
    floor = _floor_rise(raster.y) > _side_rise(raster.x)
    fan = np.maximum(0.5 + 0.8 * raster.y, 0.1)
    boards = np.where(np.floor(5.0 * raster.x / fan) % 2 == 0, 1.0, 0.75)
    image[floor] = np.array((0.60, 0.42, 0.26)) * boards[floor][:, None]
    image[(np.abs(raster.x - CENTRE[0]) < 0.018) & (raster.y < CENTRE[1])] = 0.08
    return image


def _ring_sizes() -> NDArray[np.intp]:
    """Return how many facets each ring from pole to pole has, all round the ball."""
    latitude = np.pi * ((np.arange(RINGS) + 0.5) / RINGS - 0.5)
    sizes: NDArray[np.intp] = np.rint(2 * RINGS * np.cos(latitude)).astype(np.intp)
    return sizes


def _rings(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the place of points of the frame on the ball: along the rings of facets from pole to
    pole, and along the facets of a ring; a whole number is the edge of a facet."""
    across, down = (x - CENTRE[0]) / RADIUS, (y - CENTRE[1]) / RADIUS
    up = np.sqrt(np.maximum(1.0 - across**2 - down**2, 0.0))
    ring = (np.arcsin(np.clip(down, -1.0, 1.0)) / np.pi + 0.5) * RINGS
    size = _ring_sizes()[np.minimum(ring.astype(np.intp), RINGS - 1)]
    return ring, (np.arctan2(across, up) / (2 * np.pi) + 0.5) * size


def _facet(x: Array, y: Array) -> NDArray[np.intp]:
    """Return the number of the facet at places of the frame, -1 off the ball."""
    ring, place = _rings(x, y)
    first = np.concatenate(([0], np.cumsum(_ring_sizes())[:-1]))
    number: NDArray[np.intp] = first[np.minimum(ring.astype(np.intp), RINGS - 1)]
    number = number + place.astype(np.intp)
    on_ball = ((x - CENTRE[0]) / RADIUS) ** 2 + ((y - CENTRE[1]) / RADIUS) ** 2 < 1.0
    return np.where(on_ball, number, np.intp(-1))


def _facets(seed: int) -> tuple[Array, Array]:
    """Return the normals (facets, 3), and what each facet returns at once (facets,)."""
    rng = np.random.default_rng(seed)
    normals = _facet_normals(rng)
    # A facet sends light straight back only when it faces the camera; else it is nearly black.
    facing = np.exp(-(((1.0 - normals[:, 2]) / 0.02) ** 2))
    return normals, 0.02 + 0.16 * rng.random(len(normals)) ** 2 + 0.70 * facing


def _facet_normals(rng: np.random.Generator) -> Array:
    """Return the normals (facets, 3) of the facets, each glued a little askew."""
    sizes = _ring_sizes()
    ring = np.repeat(np.arange(RINGS), sizes)
    place = np.concatenate([(np.arange(size) + 0.5) / size for size in sizes])
    latitude = np.pi * ((ring + 0.5) / RINGS - 0.5) + rng.normal(0.0, 0.03, ring.size)
    longitude = 2 * np.pi * (place - 0.5) + rng.normal(0.0, 0.03, ring.size)
    flat = np.cos(latitude)
    return np.stack([flat * np.sin(longitude), np.sin(latitude), flat * np.cos(longitude)], axis=-1)


def _paths(canvas: Canvas, normals: Array, matte: Array) -> Any:
    """Return the paths camera <- wall <- facet <- projector, sparse (N, N).

    The light of one facet travels in parallel, so it lands as a copy of the facet. `matte` (N,)
    is what the walls return of light that falls on them.
    """
    facet = _facet(canvas.x, canvas.y)
    ball = facet >= 0
    across, down = canvas.x[ball] - CENTRE[0], canvas.y[ball] - CENTRE[1]
    up = np.sqrt(RADIUS**2 - across**2 - down**2)
    origin = np.stack([canvas.x[ball], canvas.y[ball], CENTRE[2] + up], axis=-1)
    normal = normals[facet[ball]]
    ray = 2.0 * normal[:, 2:] * normal - np.array([0.0, 0.0, 1.0])

    end_x, end_y = np.full(ball.shape, np.inf), np.full(ball.shape, np.inf)
    end_x[ball], end_y[ball] = _landing(origin, ray)
    arriving = canvas.links(np.isfinite(end_x), end_x, end_y)
    # Spots behind the ball light nothing that the camera sees: `matte` is zero there.
    paths = scipy.sparse.diags_array(MIRROR * matte) @ arriving
    spots = np.asarray(paths.sum(axis=1)).ravel()
    limit = np.minimum(1.0, BUDGET / np.maximum(spots, 1e-9))
    return scipy.sparse.diags_array(limit) @ paths


def _landing(origin: Array, ray: Array) -> tuple[Array, Array]:
    """Return where rays (s, 3) from `origin` (s, 3) meet the room: x, y, infinite if nowhere."""
    x, y = np.full(len(ray), np.inf), np.full(len(ray), np.inf)
    flying = np.arange(len(ray))
    for step in range(1, STEPS + 1):
        point = origin[flying] + step * STRIDE * ray[flying]
        hit = point[:, 2] < room_height(point[:, 0], point[:, 1])
        x[flying[hit]], y[flying[hit]] = point[hit, 0], point[hit, 1]
        flying = flying[~hit]
    return x, y
