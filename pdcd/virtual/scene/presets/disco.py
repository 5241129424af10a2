"""A mirror ball in a corner: its facets throw spots of light onto walls and floor."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np
import scipy

from pdcd.virtual.scene.effects import Array, make_direct_effects, make_tint, make_two_way_paths
from pdcd.virtual.scene.presets.canvas import (
    FRAME_HEIGHT,
    FRAME_WIDTH,
    Canvas,
    FrameRaster,
    read_seed,
)
from pdcd.virtual.scene.presets.detail import (
    DARKEST_TEXTURE,
    TEXTURE_PIXELS,
    make_grain,
    make_texture_raster,
)
from pdcd.virtual.scene.presets.mirror_ball import FACET_REFLECTANCE, MirrorBall
from pdcd.virtual.scene.presets.thrown import Thrower, draw_spots
from pdcd.virtual.scene.radiosity import Relief, make_radiosity_effects
from pdcd.virtual.scene.scene import Scene

_CENTRE = (0.0, -0.14, 0.10)
"""Centre of the ball (x, y, height)."""
_RADIUS = 0.50
_RINGS = 11
"""Rings of facets from pole to pole."""
_FLOOR_EDGE, _SIDE_EDGE = 0.48, 0.98
_FLOOR_RISE, _SIDE_RISE = 1.5, 1.8
"""How steeply the floor and the side walls rise from the wall."""
_WALL = -0.5
"""Height of the wall behind the ball."""
_ROOM = (
    (_WALL, 0.0, 0.0), (_WALL - _FLOOR_RISE * _FLOOR_EDGE, 0.0, _FLOOR_RISE),
    (_WALL - _SIDE_RISE * _SIDE_EDGE, _SIDE_RISE, 0.0), (_WALL - _SIDE_RISE * _SIDE_EDGE,
    -_SIDE_RISE, 0.0),
)  # fmt: skip
"""The room as planes: wall, floor, sides."""
_BETWEEN = 0.2
"""Rough share of light on the walls that comes from other walls: the ground behind the spots."""
_BUDGET = 0.35
"""Most light that all spots on one cell may return together: no cell returns more than it got."""
_STRIDE, _STEPS = 0.01, 250
"""How finely, and how far, the light of a facet is followed."""


def disco_ball(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build a mirror ball that hangs in a room; `seed` sets how its facets were glued."""
    seed = read_seed("disco-ball", options)
    canvas = Canvas(grid)
    mirrors = MirrorBall(_CENTRE, _RADIUS, _RINGS, seed)
    facet = mirrors.facet(canvas.x, canvas.y)
    ball = facet >= 0

    relief = Relief(compute_room_height(canvas.cell_x, canvas.cell_y), canvas.pitch)
    matte = canvas.cells(np.where(ball[..., None], 0.0, _room(canvas)))
    direct = matte * relief.cosine.reshape(-1, 1)
    direct += canvas.cells(np.where(ball, mirrors.facets[1][facet], 0.0))[:, None]

    grey = matte.mean(axis=1)
    paths = _paths(canvas, mirrors, grey * relief.cosine.ravel())
    tint = make_tint(1.0, 0.92, 0.84)
    return Scene(
        "disco-ball",
        grid,
        (
            *make_direct_effects(direct),
            make_two_way_paths("spots", paths, tint),
            *make_radiosity_effects("between the walls", relief, grey[:, None], [tint]),
        ),
        texture=partial(_texture, seed),
        indirect_texture=partial(_reflections, seed),
    )


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw in detail what returns at once."""
    raster = make_texture_raster()
    mirrors = MirrorBall(_CENTRE, _RADIUS, _RINGS, seed)
    image = _in_detail(raster)
    pitch = (1.0 / TEXTURE_PIXELS, 1.0 / TEXTURE_PIXELS)
    image *= Relief(compute_room_height(raster.x, raster.y), pitch).cosine[..., None]
    mirrors.draw(raster, image, mirrors.facets[1])
    return np.maximum(image, DARKEST_TEXTURE)


@lru_cache(maxsize=1)
def _reflections(seed: int) -> Array:
    """Draw in detail where indirect light comes from: walls that light each other, the spots on
    the walls, and the facets that mirror them."""
    raster = make_texture_raster()
    mirrors = MirrorBall(_CENTRE, _RADIUS, _RINGS, seed)
    image = _in_detail(raster)
    image *= (
        _BETWEEN + draw_spots(Thrower("spots", mirrors.lands(_ROOM), FACET_REFLECTANCE))[..., None]
    )
    x, y = _landing(mirrors.middles, mirrors.rays)
    seen = (np.abs(x) < FRAME_WIDTH / 2.0) & (np.abs(y) < FRAME_HEIGHT / 2.0)
    seen[seen] = mirrors.facet(x[seen], y[seen]) < 0  # not what the ball itself hides
    mirrors.draw(raster, image, np.where(seen, 0.3, DARKEST_TEXTURE))
    return np.maximum(image, DARKEST_TEXTURE)


def _in_detail(raster: FrameRaster) -> Array:
    """Draw the room without the ball."""
    image = _room(raster)
    floor = _floor_rise(raster.y) > _side_rise(raster.x)
    image *= np.where(floor, make_grain(0.10, along=24), make_grain(0.04))[..., None]
    return image


def compute_room_height(x: Array, y: Array) -> Array:
    """Return the height of the wall, the floor and the side walls at places of the frame."""
    height: Array = _WALL + np.maximum(_floor_rise(y), _side_rise(x))
    return height


def _floor_rise(y: Array) -> Array:
    rise: Array = _FLOOR_RISE * np.maximum(y - _FLOOR_EDGE, 0.0)
    return rise


def _side_rise(x: Array) -> Array:
    rise: Array = _SIDE_RISE * np.maximum(np.abs(x) - _SIDE_EDGE, 0.0)
    return rise


def _room(raster: FrameRaster) -> Array:
    """Return the colours of wall, floor boards and the thread that holds the ball."""
    image = raster.fill((0.56, 0.51, 0.46))
    floor = _floor_rise(raster.y) > _side_rise(raster.x)
    fan = np.maximum(0.5 + 0.8 * raster.y, 0.1)
    boards = np.where(np.floor(5.0 * raster.x / fan) % 2 == 0, 1.0, 0.75)
    image[floor] = np.array((0.60, 0.42, 0.26)) * boards[floor][:, None]
    image[(np.abs(raster.x - _CENTRE[0]) < 0.018) & (raster.y < _CENTRE[1])] = 0.08
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
    paths = scipy.sparse.diags_array(FACET_REFLECTANCE * matte) @ arriving
    spots = np.asarray(paths.sum(axis=1)).ravel()
    limit = np.minimum(1.0, _BUDGET / np.maximum(spots, 1e-9))
    return scipy.sparse.diags_array(limit) @ paths


def _landing(origin: Array, ray: Array) -> tuple[Array, Array]:
    """Return where rays (s, 3) from `origin` (s, 3) meet the room: x, y, infinite if nowhere."""
    x, y = np.full(len(ray), np.inf), np.full(len(ray), np.inf)
    flying = np.arange(len(ray))
    for step in range(1, _STEPS + 1):
        point = origin[flying] + step * _STRIDE * ray[flying]
        hit = point[:, 2] < compute_room_height(point[:, 0], point[:, 1])
        x[flying[hit]], y[flying[hit]] = point[hit, 0], point[hit, 1]
        flying = flying[~hit]
    return x, y
