"""An open book: two pages that light each other, with text and a coloured picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pdcd.scene.effects import Array, coloured_direct
from pdcd.scene.presets.canvas import Canvas, Shape, generator
from pdcd.scene.radiosity import Relief, radiosity
from pdcd.scene.scene import Scene

SLOPE = 0.85
"""Rise of either page from the spine outwards: the book is open by some 99 degrees."""
PAGE_WIDTH = 1.12
PAPER = (0.84, 0.80, 0.72)
INK = (0.08, 0.07, 0.07)


def open_book(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """Build an open book in a wooden cradle, seen from above; `seed` sets the words."""
    rng = generator("open-book", options)
    canvas = Canvas(grid)
    image = canvas.fill((0.20, 0.13, 0.09))
    image += 0.04 * np.sin(9 * canvas.y + 2 * np.sin(3 * canvas.x))[..., None]

    image[_spread(canvas, PAGE_WIDTH + 0.10, 0.06)] = (0.36, 0.05, 0.05)
    image[_spread(canvas, PAGE_WIDTH + 0.05, 0.02)] = (0.62, 0.58, 0.50)
    image[_spread(canvas, PAGE_WIDTH, 0.0)] = PAPER
    _text(canvas, image, rng, left=0.17, right=0.99, lines=np.arange(-0.58, 0.62, 0.125))
    _text(canvas, image, rng, left=-0.97, right=-0.17, lines=np.arange(0.30, 0.62, 0.125))
    _picture(canvas, image)
    image[np.abs(canvas.x) < 0.012] *= 0.45

    relief = Relief(SLOPE * np.abs(canvas.cell_x), canvas.pitch)
    albedo = canvas.cells(image)
    direct = albedo * relief.cosine.reshape(-1, 1)
    indirect = radiosity("between the pages", relief, albedo, list(np.eye(3)))
    return Scene("open-book", grid, (*coloured_direct(direct), *indirect))


def _spread(canvas: Canvas, width: float, border: float) -> Shape:
    """Return both pages; their outer edges are nearer to the camera and look taller."""
    far = np.abs(canvas.x)
    tall = 0.70 + border + 0.14 * far + 0.05 * np.sin(np.pi * np.minimum(far / width, 1.0))
    inside: Shape = (far <= width) & (np.abs(canvas.y) <= tall)
    return inside


def _text(
    canvas: Canvas,
    image: Array,
    rng: np.random.Generator,
    *,
    left: float,
    right: float,
    lines: Array,
) -> None:
    """Draw lines of words from `left` to `right`, spread like the page they stand on."""
    for number, line in enumerate(lines):
        x = left
        end = right if number % 4 != 3 else left + 0.6 * (right - left)
        while x < end - 0.05:
            word = min(rng.uniform(0.08, 0.26), end - x)
            stretch = 1.0 + 0.2 * np.abs(canvas.x)
            on_line = np.abs(canvas.y - line * stretch) < 0.028
            image[on_line & (canvas.x >= x) & (canvas.x < x + word)] = INK
            x += word + 0.055


def _picture(canvas: Canvas, image: Array) -> None:
    """Draw a framed landscape on the left page: colours that bleed onto the other one."""
    frame = canvas.box(-0.98, -0.66, -0.16, 0.14)
    image[frame] = INK
    inside = canvas.box(-0.94, -0.62, -0.20, 0.10)
    image[inside] = (0.35, 0.55, 0.80)
    image[inside & canvas.disk(-0.72, -0.38, 0.14)] = (0.88, 0.68, 0.10)
    hills = canvas.y > -0.10 + 0.12 * np.sin(6.5 * canvas.x)
    image[inside & hills] = (0.15, 0.50, 0.15)
    house = canvas.box(-0.44, -0.22, -0.26, 0.00)
    image[inside & house] = (0.80, 0.15, 0.08)
    image[canvas.polygon([(-0.48, -0.20), (-0.22, -0.20), (-0.35, -0.36)])] = (0.35, 0.12, 0.08)
