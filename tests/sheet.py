"""The contact sheet of the preset scenes: ``python -m tests.sheet`` writes docs/scenes.png.

Each scene stands under full white light, at the pixels of its texture, scaled down; the last tile
is a part of the book at its own pixels. Nothing here is a photo: no mask, no camera, no noise.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pdcd.scene.effects import Array
from pdcd.scene.presets import PRESETS
from pdcd.scene.scene import Scene
from pdcd.scene.texture import cell_means, detailed
from tests.places import ROOT

GRID = (48, 64)
TILE = (360, 480)
"""Rows and columns of a scene on the sheet."""
PART = (90, 330)
"""Row and column where the part of the book begins."""
ACROSS = 3
STEP = 3
"""Levels of 256 from one grey to the next: nobody sees it, and a file is two thirds as large."""
WHITE = 99.7
"""Per cent of the values of a picture that are not clipped."""


def floodlit(scene: Scene) -> Array:
    """What leaves a scene under white light, (H, W, 3) at the pixels of its textures."""
    if scene.textures is None:
        raise ValueError(f"{scene.name} has no texture")
    height, width, _ = scene.textures[0].shape
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    points = np.stack([x, y], axis=-1)
    parts = zip(scene.split(), scene.textures, strict=True)
    light: Array = sum(
        (detailed(cells, scene.grid, texture, points) for cells, texture in parts),
        np.zeros((height, width, 3)),
    )
    return light


def main(path: Path) -> None:
    """Draw all presets, in their order."""
    tiles = []
    for name, build in PRESETS.items():
        light = floodlit(build(GRID, {}))
        light /= np.percentile(light, WHITE)
        tiles.append(cell_means(light, TILE).reshape(*TILE, 3))
        if name == "open-book":
            book = light[PART[0] : PART[0] + TILE[0], PART[1] : PART[1] + TILE[1]]
    tiles.append(book)
    rows = [np.concatenate(tiles[i : i + ACROSS], axis=1) for i in range(0, len(tiles), ACROSS)]
    levels = 255.0 * np.clip(np.concatenate(rows), 0.0, 1.0) ** (1.0 / 2.2)
    save(levels, path)


def save(levels: NDArray[np.floating], path: Path) -> None:
    """Write a picture (H, W, 3) of 0 to 255, rounded to steps of `STEP`."""
    coarse = np.minimum(STEP * np.rint(levels / STEP), 255.0)
    Image.fromarray(coarse.astype(np.uint8)).save(path, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "scenes.png")
