"""Light that glass and mirrors throw from one place of the frame to another: spots and caustics.

A thrower says where the light goes that falls on a place. The same function serves twice: between
cells it makes the paths of light transport, and at the pixels of a texture it makes the picture of
the spots, as sharp as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from scipy.ndimage import gaussian_filter

from pdcd.virtual.scene.effects import COLOUR_NAMES, Array, SparseEffect, make_two_way_paths
from pdcd.virtual.scene.presets.canvas import FRAME_HEIGHT, FRAME_WIDTH, Canvas, Shape
from pdcd.virtual.scene.presets.detail import DETAIL, TEXTURE_PIXELS, make_texture_raster
from pdcd.virtual.scene.texture import sample_texture

_SOFT_PX = 1.1
"""Blur of spots in detail, as a texture has few rays in a pixel."""
_RAYS = 4
"""Rays of a pixel along either axis."""

Landing = Callable[[Array, Array], tuple[Shape, Array, Array]]
"""From places x, y of the frame, of any shape, to: whether light is thrown from there, and the
places where it arrives, of the same shape (of no meaning where none is thrown)."""


@dataclass(frozen=True)
class Thrower:
    """A piece of glass, a mirror, a handful of glitter.

    name : str
    lands : see `Landing`
    share : float
        Share of the light on it that it throws, 0 to 1.
    budget : float
        Most that a cell may return of light thrown at it, so that no cell returns more than it got.
    """

    name: str
    lands: Landing
    share: float
    budget: float = 0.5


@dataclass(frozen=True, eq=False)
class _Thrown:
    """What throwers do between cells.

    effects : paths from throwers to what they light, and back, a colour each
    back : (N, 3) float64
        Light that returns to the very point of a thrower that threw it: it counts as direct, see
        row 1 of Table 2 of the paper.
    """

    effects: tuple[SparseEffect, ...]
    back: Array


def make_thrown_paths(canvas: Canvas, throwers: Sequence[Thrower], lit: Array) -> _Thrown:
    """Return the paths of all throwers; `lit` (N, 3) is the share of light that cells return, slope
    included, as for direct light."""
    effects: list[SparseEffect] = []
    back = np.zeros_like(lit)
    for one in throwers:
        arriving = one.share * _links(canvas, one)
        total = lit * np.asarray(arriving.sum(axis=1)).ravel()[:, None]
        reached = lit * np.minimum(1.0, one.budget / np.maximum(total, 1e-9))
        back += one.share * (arriving.T @ reached)
        for channel, colour in enumerate(COLOUR_NAMES):
            paths = scipy.sparse.diags_array(reached[:, channel]) @ arriving
            # A path within a cell is its own way back: it must not be counted twice.
            paths = paths - scipy.sparse.diags_array(0.5 * paths.diagonal())
            effects.append(make_two_way_paths(f"{one.name}, {colour}", paths, np.eye(3)[channel]))
    return _Thrown(tuple(effects), back)


def draw_thrown_light(throwers: Sequence[Thrower], lit: Array) -> Array:
    """Return the light that throwers send, and the light seen in them, (H, W, 3) of `DETAIL`.

    lit : (H, W, 3) float64, as that of cells
    """
    light = np.zeros((*DETAIL, 3))
    for one in throwers:
        light += draw_spots(one)[..., None] * lit
    return light + _shown(throwers, lit)


def draw_returned_light(throwers: Sequence[Thrower], lit: Array) -> Array:
    """Return light that comes back to its own point of a thrower, (H, W, 3) of `DETAIL`."""
    light = np.zeros((*DETAIL, 3))
    for one in throwers:
        light += one.share * _shown([one], lit)
    return light


def draw_spots(one: Thrower) -> Array:
    """Return the light that arrives at each pixel, (H, W) of `DETAIL`; 1 is full projection."""
    raster = make_texture_raster()
    light = np.zeros(DETAIL[0] * DETAIL[1])
    rng = np.random.default_rng(1)  # rays at even steps would draw rings
    on = one.lands(raster.x, raster.y)[0]
    # Some rays of a pixel may leave from a thrower whose middle does not.
    near = gaussian_filter(on.astype(np.float32), 2.0) > 0.01
    from_x, from_y = raster.x[near], raster.y[near]
    for number in range(_RAYS**2):
        within = rng.random((2, from_x.size))
        right, down = (within + np.array([[number % _RAYS], [number // _RAYS]])) / _RAYS - 0.5
        hit, x, y = one.lands(from_x + right / TEXTURE_PIXELS, from_y + down / TEXTURE_PIXELS)
        col = np.floor((x[hit] + FRAME_WIDTH / 2.0) * TEXTURE_PIXELS).astype(np.intp)
        row = np.floor((y[hit] + FRAME_HEIGHT / 2.0) * TEXTURE_PIXELS).astype(np.intp)
        seen = (row >= 0) & (row < DETAIL[0]) & (col >= 0) & (col < DETAIL[1])
        light += np.bincount(row[seen] * DETAIL[1] + col[seen], minlength=light.size)
    arrived: Array = gaussian_filter(light.reshape(DETAIL), _SOFT_PX)
    return arrived * (one.share / _RAYS**2)


def _shown(throwers: Sequence[Thrower], lit: Array) -> Array:
    """What throwers show of `lit`: they are seen along the ways of their light."""
    raster = make_texture_raster()
    light = np.zeros((*DETAIL, 3))
    for one in throwers:
        hit, x, y = one.lands(raster.x, raster.y)
        hit = hit & (np.abs(x) < FRAME_WIDTH / 2.0) & (np.abs(y) < FRAME_HEIGHT / 2.0)
        place = np.stack([x[hit] / FRAME_WIDTH, y[hit] / FRAME_HEIGHT], axis=-1) + 0.5
        light[hit] += one.share * sample_texture(lit, place)
    return light


def _links(canvas: Canvas, one: Thrower) -> Any:
    """Where the light of each cell arrives, sparse (N to, N from)."""
    hit, x, y = one.lands(canvas.x, canvas.y)
    return canvas.links(hit, np.where(hit, x, np.inf), np.where(hit, y, np.inf))
