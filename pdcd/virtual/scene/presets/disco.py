"""A mirror ball in a corner: its facets throw spots of light onto walls and floor."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np
import scipy

from pdcd.virtual.scene.effects import Array, both_ways, coloured_direct, rgb
from pdcd.virtual.scene.presets.canvas import HEIGHT, WIDTH, Canvas, Raster, seed_of
from pdcd.virtual.scene.presets.detail import DARKEST, PIXELS, detail, grain
from pdcd.virtual.scene.presets.mirror_ball import MIRROR, MirrorBall
from pdcd.virtual.scene.presets.thrown import Thrower, spots
from pdcd.virtual.scene.radiosity import Relief, radiosity
from pdcd.virtual.scene.scene import Scene

CENTRE = (0.0, -0.14, 0.10)
"""Of the ball (x, y, height)."""
RADIUS = 0.50
RINGS = 11
"""Rings of facets from pole to pole."""
FLOOR_EDGE, SIDE_EDGE = 0.48, 0.98
FLOOR_RISE, SIDE_RISE = 1.5, 1.8
"""Where the wall turns into the floor and into the side walls."""
WALL = -0.5
"""Height of the wall behind the ball."""
ROOM = (
    (WALL, 0.0, 0.0), (WALL - FLOOR_RISE * FLOOR_EDGE, 0.0, FLOOR_RISE),
    (WALL - SIDE_RISE * SIDE_EDGE, SIDE_RISE, 0.0), (WALL - SIDE_RISE * SIDE_EDGE, -SIDE_RISE, 0.0),
)  # fmt: skip
"""The same as planes: wall, floor, sides."""
BETWEEN = 0.2
"""Light on the walls that comes from other walls, about: what spots stand out from."""
BUDGET = 0.35
"""Most that all spots on one cell may return together, so that no cell returns more than it got."""
STRIDE, STEPS = 0.01, 250
"""How finely, and how far, the light of a facet is followed."""


def disco_ball(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build a mirror ball that hangs in a room; `seed` sets how its facets were glued."""
    seed = seed_of("disco-ball", options)
    canvas = Canvas(grid)
    mirrors = MirrorBall(CENTRE, RADIUS, RINGS, seed)
    facet = mirrors.facet(canvas.x, canvas.y)
    ball = facet >= 0

    relief = Relief(room_height(canvas.cell_x, canvas.cell_y), canvas.pitch)
    matte = canvas.cells(np.where(ball[..., None], 0.0, _room(canvas)))
    direct = matte * relief.cosine.reshape(-1, 1)
    direct += canvas.cells(np.where(ball, mirrors.facets[1][facet], 0.0))[:, None]

    grey = matte.mean(axis=1)
    paths = _paths(canvas, mirrors, grey * relief.cosine.ravel())
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
    mirrors = MirrorBall(CENTRE, RADIUS, RINGS, seed)
    image = _in_detail(raster)
    pitch = (1.0 / PIXELS, 1.0 / PIXELS)
    image *= Relief(room_height(raster.x, raster.y), pitch).cosine[..., None]
    mirrors.draw(raster, image, mirrors.facets[1])
    return np.maximum(image, DARKEST)


@lru_cache(maxsize=1)
def _reflections(seed: int) -> Array:
    """Draw in detail where indirect light comes from: walls that light each other, the spots on
    them, and facets that show them."""
    raster = detail()
    mirrors = MirrorBall(CENTRE, RADIUS, RINGS, seed)
    image = _in_detail(raster)
    image *= BETWEEN + spots(Thrower("spots", mirrors.lands(ROOM), MIRROR))[..., None]
    x, y = _landing(mirrors.middles, mirrors.rays)
    seen = (np.abs(x) < WIDTH / 2.0) & (np.abs(y) < HEIGHT / 2.0)
    seen[seen] = mirrors.facet(x[seen], y[seen]) < 0  # not what the ball itself hides
    mirrors.draw(raster, image, np.where(seen, 0.3, DARKEST))
    return np.maximum(image, DARKEST)


def _in_detail(raster: Raster) -> Array:
    """Draw the room without the ball."""
    image = _room(raster)
    floor = _floor_rise(raster.y) > _side_rise(raster.x)
    image *= np.where(floor, grain(0.10, along=24), grain(0.04))[..., None]
    return image


def room_height(x: Array, y: Array) -> Array:
    """Return the height of the wall, the floor and the side walls at places of the frame."""
    height: Array = WALL + np.maximum(_floor_rise(y), _side_rise(x))
    return height


def _floor_rise(y: Array) -> Array:
    rise: Array = FLOOR_RISE * np.maximum(y - FLOOR_EDGE, 0.0)
    return rise


def _side_rise(x: Array) -> Array:
    rise: Array = SIDE_RISE * np.maximum(np.abs(x) - SIDE_EDGE, 0.0)
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


def _paths(canvas: Canvas, mirrors: MirrorBall, matte: Array) -> Any:
    """Return the paths camera <- wall <- facet <- projector, sparse (N, N).

    The light of one facet travels in parallel, so it lands as a copy of the facet. `matte` (N,)
    is what the walls return of light that falls on them.
    """
    facet = mirrors.facet(canvas.x, canvas.y)
    ball = facet >= 0
    origin = mirrors.points(canvas.x[ball], canvas.y[ball])
    ray = mirrors.rays[facet[ball]]

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
