"""A vase beside a mirror: sharp paths between them both ways, over matte inter-reflection."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.sparse
from scipy.interpolate import PchipInterpolator

from pdcd.scene.effects import COLOURS, Array, Effect, both_ways, coloured_direct
from pdcd.scene.presets.canvas import Canvas, Shape, generator
from pdcd.scene.radiosity import Relief, radiosity
from pdcd.scene.scene import Scene

VASE_X = 0.52
PROFILE_Y = (-0.72, -0.66, -0.48, -0.05, 0.40, 0.62, 0.70)
PROFILE_RADIUS = (0.22, 0.19, 0.13, 0.36, 0.30, 0.17, 0.22)
"""Radius of the vase at heights from its lip to its foot."""
MIRROR_X, MIRROR_HALF = -0.72, 0.36
"""Middle and half width of the mirror as the camera sees it, slantwise."""
SQUEEZE = 1.25
"""How much narrower things look in the slanted mirror."""
MIRROR = 0.80
"""Reflectance of the mirror."""
GRAZING = 0.4
"""Cosine at which light from the mirror meets what it lights."""
TABLE_EDGE = 0.50


def mirror_and_vase(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build a painted vase with a mirror to its left; `seed` sets the painting."""
    rng = generator("mirror-and-vase", options)
    canvas = Canvas(grid)
    glass, frame = _mirror(canvas, 0.0), _mirror(canvas, 0.07)

    matte_image = canvas.fill((0.66, 0.60, 0.48))
    matte_image[canvas.y > TABLE_EDGE] = (0.40, 0.26, 0.15)
    matte_image[np.abs(canvas.x - VASE_X) < _radius(canvas.y)] = (0.70, 0.70, 0.68)
    _paint(canvas, matte_image, rng)
    matte_image[frame] = (0.45, 0.30, 0.10)
    matte_image[glass] = 0.0

    relief = Relief(_height(canvas), canvas.pitch)
    albedo = canvas.cells(matte_image)
    direct = albedo * relief.cosine.reshape(-1, 1)
    # The mirror shows things flipped sideways; light goes the same way as sight.
    shown = canvas.links(glass, VASE_X - SQUEEZE * (canvas.x - MIRROR_X), canvas.y)
    reached = MIRROR * GRAZING * direct
    # There and back by the mirror: such light returns to its own cell and counts as direct.
    direct = direct + MIRROR * (shown.T @ reached)
    effects: list[Effect] = [*coloured_direct(direct)]
    for channel, colour in enumerate(COLOURS):
        one_way = scipy.sparse.diags_array(reached[:, channel]) @ shown
        effects.append(both_ways(f"mirror {colour}", one_way, np.eye(3)[channel]))
    effects.extend(radiosity("between the walls", relief, albedo, list(np.eye(3))))
    return Scene("mirror-and-vase", grid, tuple(effects))


def _radius(y: Array) -> Array:
    """Return the radius of the vase at each height y, 0 above and below it."""
    profile = PchipInterpolator(PROFILE_Y, PROFILE_RADIUS, extrapolate=False)
    radius: Array = np.nan_to_num(profile(y))
    return radius


def _mirror(canvas: Canvas, border: float) -> Shape:
    """Return the mirror: it stands on the table, its left edge nearer to the camera."""
    across = (canvas.x - MIRROR_X) / MIRROR_HALF
    half = 0.70 - 0.07 * across + border
    inside: Shape = np.abs(canvas.x - MIRROR_X) < MIRROR_HALF + border
    inside &= np.abs(canvas.y + 0.03) < half
    return inside


def _paint(canvas: Canvas, image: Array, rng: np.random.Generator) -> None:
    """Paint bands, and petals at places of their own, round the vase."""
    blue, red = (0.10, 0.18, 0.58), (0.70, 0.16, 0.10)
    radius = _radius(canvas.y)
    vase = np.abs(canvas.x - VASE_X) < radius
    round_ = np.arcsin(np.clip((canvas.x - VASE_X) / np.maximum(radius, 1e-9), -1.0, 1.0))
    for top, bottom in ((-0.72, -0.64), (-0.42, -0.34), (0.34, 0.42), (0.62, 0.72)):
        image[vase & (canvas.y >= top) & (canvas.y < bottom)] = blue
    turn = rng.uniform(0.0, 1.0)
    phase = (round_ / 0.7 + turn) % 1.0 - 0.5
    for centre, colour in ((-0.14, red), (0.14, blue)):
        petal = np.hypot(phase / 0.36, (canvas.y - centre) / 0.11) < 1.0
        image[vase & petal] = colour


def _height(canvas: Canvas) -> Array:
    """Return the height of wall, table and vase; the mirror counts as part of the wall."""
    table = 1.3 * np.maximum(canvas.cell_y - TABLE_EDGE, 0.0)
    radius = _radius(canvas.cell_y)
    bulge = radius**2 - (canvas.cell_x - VASE_X) ** 2
    vase = np.where(bulge > 0, 0.45 + np.sqrt(np.maximum(bulge, 0.0)), 0.0)
    height: Array = np.maximum(table, vase)
    return height
