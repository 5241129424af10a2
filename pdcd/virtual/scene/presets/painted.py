"""Paint on box, wall and floor (boards and letters, bricks), as an off-axis camera sees it.

The light transport only knows which surface the middle of a camera cell sees. So a cell shows that
surface all over, and edges of surfaces lie at edges of cells.
"""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from pdcd.virtual.scene.depth import PLANE, OffAxisRig, Paint
from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.presets.canvas import FRAME_HEIGHT, FRAME_WIDTH
from pdcd.virtual.scene.presets.detail import (
    DARKEST_TEXTURE,
    draw_text,
    make_grain,
    make_texture_raster,
)
from pdcd.virtual.scene.presets.letters import Coverage
from pdcd.virtual.scene.solids import Rectangle
from pdcd.virtual.scene.texture import average_cells, sample_texture

_FACES = 5
"""Number of the box's faces, which come first; then the wall, then the floor."""
_WORDS = (("Red box", -0.62, -0.02, 0.155), ("at one depth", -0.61, 0.32, 0.088))
"""Text on the front of the box, which reaches over 1.6 x 1.2 of the frame here."""
_REACH = 0.6


def paint_box(rig: OffAxisRig) -> Paint:
    """Return the paint of a box on a floor, in front of a wall."""
    pattern = average_cells(_pattern(rig)[0][..., None], rig.grid)
    return Paint(pattern, partial(_direct, rig), partial(_indirect, rig))


@lru_cache(maxsize=2)
def _direct(rig: OffAxisRig) -> Array:
    """Draw direct light in detail: the colour of things, lit as they face the projector."""
    _, points, which = _pattern(rig)
    normals = np.array([one.normal for one in rig.surfaces])[which]
    square = np.sum(points**2, axis=-1)
    facing: Array = np.abs(np.sum(normals * points, axis=-1)) * PLANE**2 / square**1.5
    lit: Array = np.maximum(_indirect(rig) * facing[..., None], DARKEST_TEXTURE)
    return lit


@lru_cache(maxsize=2)
def _indirect(rig: OffAxisRig) -> Array:
    """Draw the colour of things in detail."""
    pattern, _, which = _pattern(rig)
    colour = np.array([one.albedo for one in rig.surfaces])[which]
    drawn: Array = np.maximum(colour * (pattern * make_grain(0.02))[..., None], DARKEST_TEXTURE)
    return drawn


@lru_cache(maxsize=2)
def _pattern(rig: OffAxisRig) -> tuple[Array, Array, NDArray[np.intp]]:
    """Factors of the paint (H, W) of `DETAIL`, the points seen (H, W, 3), and their surfaces."""
    raster = make_texture_raster()
    row = ((raster.y / FRAME_HEIGHT + 0.5) * rig.grid[0]).astype(np.intp)
    col = ((raster.x / FRAME_WIDTH + 0.5) * rig.grid[1]).astype(np.intp)
    which = rig.seen[0].reshape(rig.grid)[row, col]
    eye = np.array([rig.baseline, 0.0, 0.0])
    flat = np.stack([raster.x / 2.0, raster.y / 2.0, np.full(raster.shape, PLANE)], axis=-1)
    factors, points = np.ones(raster.shape), flat.copy()
    for number, one in enumerate(rig.surfaces):
        on = which == number
        way = flat[on] - eye
        far = (np.asarray(one.corner) - eye) @ one.normal / (way @ one.normal)
        points[on] = eye + far[:, None] * way
        factors[on] = _factors(number, one, *one.place(points[on]))
    return factors, points, which


def _factors(number: int, one: Rectangle, u: Array, v: Array) -> Array:
    """Factors of one surface at places 0 to 1 along its edges, (n,) each."""
    wide, tall = np.linalg.norm(one.across) * u, np.linalg.norm(one.down) * v
    if number == 0:
        border = np.minimum(np.minimum(u, 1.0 - u), np.minimum(v, 1.0 - v)) < 0.05
        place = np.clip(np.stack([u, v], axis=-1) * _REACH + (1.0 - _REACH) / 2.0, 0.0, 0.999)
        ink = sample_texture(_label()[..., None].astype(np.float64), place)[:, 0]
        return np.where(border, 0.6, 1.0) * (1.0 - 0.85 * ink)
    if number < _FACES:
        return np.where(np.floor(wide / 0.06) % 2 == 0, 1.0, 0.85)
    if number == _FACES:  # bricks
        course = np.floor(tall / 0.14)
        joint = (tall / 0.14 % 1.0 < 0.08) | ((wide / 0.34 + 0.5 * (course % 2)) % 1.0 < 0.035)
        return np.where(joint, 0.55, 0.9 + 0.08 * np.sin(17.0 * course))
    return np.where(np.floor(wide / 0.22) % 2 == 0, 1.0, 0.7)


@lru_cache(maxsize=1)
def _label() -> Coverage:
    return draw_text(_WORDS)
