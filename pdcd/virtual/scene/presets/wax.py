"""A disk of wax with a key inside, which only light that went deep can show."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np

from pdcd.virtual.scene.effects import Array, Effect, make_direct_effects, make_tint
from pdcd.virtual.scene.kernel import KernelEffect, make_gaussian_kernel
from pdcd.virtual.scene.presets.canvas import Canvas, FrameRaster, Shape, read_seed
from pdcd.virtual.scene.presets.detail import (
    DARKEST_TEXTURE,
    draw_scratches,
    make_grain,
    make_texture_raster,
)
from pdcd.virtual.scene.scene import Scene

_RADIUS = 0.82
_SHALLOW, _DEEP = 0.06, 0.22
"""Distances that light wanders below the surface, one standard deviation: two Gaussians stand
for the peak and the tail of the profile of a translucent body."""
BLOCKED = 0.65
"""Share of the deep light that the key keeps from getting out, and from getting in."""
LIGHT_SHALLOW, LIGHT_DEEP = (0.14, 0.11, 0.06), (0.58, 0.40, 0.20)
"""What comes back from either depth, in R, G and B."""
_HAIRLINES = 110
"""Scratches that are finer than cells."""


def wax_disk(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build a wax disk on a dark cloth; `seed` sets the scratches of its surface."""
    seed = read_seed("wax-disk", options)
    canvas = Canvas(grid)
    body = canvas.cells(_disk(canvas))
    # The key lies deep: light of the shallow kernel never gets there.
    open_ = body * (1.0 - BLOCKED * canvas.cells(_key(canvas)))
    effects: tuple[Effect, ...] = (
        *make_direct_effects(canvas.cells(_surface(canvas, np.random.default_rng(seed)))),
        *make_wax_kernels(canvas, body, open_),
    )
    texture = partial(_texture, seed)
    return Scene("wax-disk", grid, effects, texture=texture, indirect_texture=_glow)


def make_wax_kernels(
    canvas: Canvas, body: Array, open_: Array, size: float = 1.0
) -> tuple[KernelEffect, KernelEffect]:
    """Return the light that comes out of wax: from just below the surface, and from deep inside.

    body, open_ : (N,) share of cells through which light gets in and out, just below and deep
    size : of the whole piece; 1 is the disk of `wax_disk`
    """
    shallow, deep = (
        make_gaussian_kernel(canvas.grid, canvas.pitch, size * far) for far in (_SHALLOW, _DEEP)
    )
    return (
        KernelEffect(
            "just below", canvas.grid, shallow, body, body, tint=make_tint(*LIGHT_SHALLOW)
        ),
        KernelEffect("deep inside", canvas.grid, deep, open_, open_, tint=make_tint(*LIGHT_DEEP)),
    )


def _disk(raster: FrameRaster) -> Shape:
    return raster.disk(0.0, 0.0, _RADIUS)


def _surface(raster: FrameRaster, rng: np.random.Generator) -> Array:
    """Draw what reflects at once."""
    radius = np.hypot(raster.x, raster.y)
    disk = _disk(raster)
    image = raster.fill((0.07, 0.08, 0.11))
    weave = np.sin(40 * raster.x) * np.sin(40 * raster.y)
    image += 0.015 * weave[..., None]
    image[disk] = (0.19, 0.18, 0.15)
    # A bevelled rim: brighter on the side that leans to the camera's upper left.
    rim = disk & (radius > _RADIUS - 0.07)
    lean = (-raster.x - raster.y) / np.maximum(radius, 1e-9)
    image[rim] *= (1.0 + 0.45 * lean[rim])[:, None]
    for angle, place in zip(rng.uniform(0, np.pi, 9), rng.uniform(-0.7, 0.7, 9), strict=True):
        across = raster.x * np.cos(angle) + raster.y * np.sin(angle)
        image[disk & (np.abs(across - place) < 0.008)] *= 1.25
    return image


@lru_cache(maxsize=1)
def _texture(seed: int) -> Array:
    """Draw the surface in detail, with hairlines in the wax and threads in the cloth."""
    raster = make_texture_raster()
    rng = np.random.default_rng(seed)
    image = _surface(raster, rng)
    threads = 1.0 + 0.25 * np.sin(480 * raster.x) * np.sin(480 * raster.y)
    hairlines = 1.0 + 0.5 * draw_scratches(rng, _HAIRLINES, _RADIUS)
    image *= np.where(_disk(raster), hairlines * make_grain(0.01), threads)[..., None]
    return image


@cache
def _glow() -> Array:
    """Draw the light from inside: it shows the key, but no scratches."""
    raster = make_texture_raster()
    open_ = 1.0 - BLOCKED * _key(raster)[..., None]
    glow: Array = np.asarray(LIGHT_SHALLOW) + np.asarray(LIGHT_DEEP) * open_
    return np.where(_disk(raster)[..., None], glow, DARKEST_TEXTURE)


def _key(raster: FrameRaster) -> Shape:
    """Return a key: a ring, a shaft and two teeth."""
    ring = raster.disk(-0.36, 0.0, 0.24) & ~raster.disk(-0.36, 0.0, 0.12)
    shaft = raster.box(-0.14, -0.055, 0.58, 0.055)
    teeth = raster.box(0.30, 0.0, 0.40, 0.22) | raster.box(0.48, 0.0, 0.58, 0.26)
    return ring | shaft | teeth
