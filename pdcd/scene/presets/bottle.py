"""A bottle of milky water with a label behind it: a veil hides what direct light still shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pdcd.scene.effects import Array, rgb
from pdcd.scene.milk import milk
from pdcd.scene.presets.canvas import Canvas, Shape, generator
from pdcd.scene.scene import Scene

OPTICAL_DEPTH = 0.75
"""Of the milk along the bottle's axis."""
PROFILE_Y = (-0.94, -0.80, -0.79, -0.52, -0.22, -0.10, 0.80, 0.86)
PROFILE_HALF = (0.15, 0.15, 0.12, 0.13, 0.40, 0.46, 0.46, 0.40)
"""Half width of the bottle at heights from its cap to its foot."""
MILK_TOP = -0.50


def milky_bottle(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build a bottle before a tiled wall; `seed` sets the shades of the tiles."""
    rng = generator("milky-bottle", options)
    canvas = Canvas(grid)
    half = np.interp(canvas.y, PROFILE_Y, PROFILE_HALF, left=0.0, right=0.0)
    bottle: Shape = np.abs(canvas.x) < half
    cap = canvas.box(-0.15, -0.94, 0.15, -0.79)

    image = _wall(canvas, rng)
    inside = bottle & ~cap
    image[inside] = 0.30
    _label(canvas, image)
    image[cap] = (0.70, 0.12, 0.10)
    edge = inside & (np.abs(canvas.x) > half - 0.03)
    image[edge] *= 0.4

    filled = inside & (canvas.y > MILK_TOP)
    # A round bottle: the way through the milk is longest on the axis.
    across = np.where(filled, canvas.x / np.maximum(half, 1e-9), 1.0)
    depth = OPTICAL_DEPTH * np.sqrt(np.maximum(1.0 - across**2, 0.0))
    effects = milk(
        grid,
        canvas.pitch,
        canvas.cells(depth),
        canvas.cells(image),
        sigma=0.12,
        tint=rgb(0.95, 0.93, 0.86),
    )
    return Scene("milky-bottle", grid, effects)


def _wall(canvas: Canvas, rng: np.random.Generator) -> Array:
    """Return tiles above a table."""
    image = canvas.fill((0.28, 0.42, 0.46))
    tile = 0.4
    shades = rng.uniform(0.8, 1.1, (8, 8))
    row, col = ((place + 2.0) // tile for place in (canvas.y, canvas.x))
    image *= shades[row.astype(int) % 8, col.astype(int) % 8][..., None]
    joint = ((canvas.x + 2.0) % tile < 0.03) | ((canvas.y + 2.0) % tile < 0.03)
    image[joint] = (0.55, 0.55, 0.52)
    image[canvas.y > 0.78] = (0.34, 0.22, 0.13)
    return image


def _label(canvas: Canvas, image: Array) -> None:
    """Draw a label with a bold M between two bands."""
    image[canvas.box(-0.38, 0.0, 0.38, 0.70)] = (0.85, 0.85, 0.82)
    for top in (0.05, 0.60):
        image[canvas.box(-0.38, top, 0.38, top + 0.06)] = (0.75, 0.10, 0.08)
    letter = canvas.polygon(
        [
            (-0.26, 0.54), (-0.26, 0.16), (-0.15, 0.16), (0.00, 0.34), (0.15, 0.16), (0.26, 0.16),
            (0.26, 0.54), (0.15, 0.54), (0.15, 0.34), (0.00, 0.50), (-0.15, 0.34), (-0.15, 0.54),
        ]
    )  # fmt: skip
    image[letter] = (0.05, 0.10, 0.35)
