"""A disk of wax with a key inside, which only light that went deep can show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pdcd.scene.effects import coloured_direct, rgb
from pdcd.scene.kernel import Kernel, gaussian
from pdcd.scene.presets.canvas import Canvas, Shape, generator
from pdcd.scene.scene import Scene

RADIUS = 0.82
SHALLOW, DEEP = 0.06, 0.22
"""Distances that light wanders below the surface, one standard deviation: two Gaussians stand
for the peak and the tail of the profile of a translucent body."""
BLOCKED = 0.65
"""Share of the deep light that the key keeps from getting out, and from getting in."""


def wax_disk(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build a wax disk on a dark cloth; `seed` sets the scratches of its surface."""
    rng = generator("wax-disk", options)
    canvas = Canvas(grid)
    radius = np.hypot(canvas.x, canvas.y)
    disk = radius <= RADIUS

    image = canvas.fill((0.07, 0.08, 0.11))
    weave = np.sin(40 * canvas.x) * np.sin(40 * canvas.y)
    image += 0.015 * weave[..., None]
    image[disk] = (0.19, 0.18, 0.15)
    # A bevelled rim: brighter on the side that leans to the camera's upper left.
    rim = disk & (radius > RADIUS - 0.07)
    lean = (-canvas.x - canvas.y) / np.maximum(radius, 1e-9)
    image[rim] *= (1.0 + 0.45 * lean[rim])[:, None]
    for angle, place in zip(rng.uniform(0, np.pi, 9), rng.uniform(-0.7, 0.7, 9), strict=True):
        across = canvas.x * np.cos(angle) + canvas.y * np.sin(angle)
        image[disk & (np.abs(across - place) < 0.008)] *= 1.25

    body = canvas.cells(disk)
    # The key lies deep: light of the shallow kernel never gets there.
    open_ = body * (1.0 - BLOCKED * canvas.cells(_key(canvas)))
    shallow = gaussian(grid, canvas.pitch, SHALLOW)
    deep = gaussian(grid, canvas.pitch, DEEP)
    return Scene(
        "wax-disk",
        grid,
        (
            *coloured_direct(canvas.cells(image)),
            Kernel("just below", grid, shallow, body, body, tint=rgb(0.14, 0.11, 0.06)),
            Kernel("deep inside", grid, deep, open_, open_, tint=rgb(0.58, 0.40, 0.20)),
        ),
    )


def _key(canvas: Canvas) -> Shape:
    """Return a key: a ring, a shaft and two teeth."""
    ring = canvas.disk(-0.36, 0.0, 0.24) & ~canvas.disk(-0.36, 0.0, 0.12)
    shaft = canvas.box(-0.14, -0.055, 0.58, 0.055)
    teeth = canvas.box(0.30, 0.0, 0.40, 0.22) | canvas.box(0.48, 0.0, 0.58, 0.26)
    return ring | shaft | teeth
