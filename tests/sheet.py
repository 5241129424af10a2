"""The contact sheet of the preset scenes: ``python -m tests.sheet`` writes docs/scenes.png.

Each scene stands three times: under full white light, its indirect light, and its direct light, at
the pixels of its texture, scaled down. Nothing here is a photo: no mask, no camera, no noise.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pdcd.virtual.scene.displaced import DisplacedEffect
from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.presets import PRESETS, STAGED, find_builder
from pdcd.virtual.scene.scene import Scene
from pdcd.virtual.scene.texture import average_cells
from tests.places import ROOT
from tests.textured import detailed

GRID = (48, 64)
TILE = (180, 240)
"""Rows and columns of a picture on the sheet."""
SCENES: tuple[tuple[str, dict[str, object]], ...] = (
    *((name, {}) for name in (*PRESETS, *STAGED)),
    ("off-axis-box", {"painted": True, "disparity": 1.0}),
)
ACROSS = 2
"""Scenes beside each other."""
STEP = 3
"""Levels of 256 from one grey to the next: nobody sees it, and a file is two thirds as large."""
WHITE = 99.7
"""Per cent of the values of a picture that are not clipped."""


def lights(scene: Scene) -> tuple[Array, Array]:
    """Direct and indirect light that leaves a scene, (H, W, 3) at the pixels of its textures."""
    if scene.textures is None:
        raise ValueError(f"{scene.name} has no texture")
    height, width, _ = scene.textures[0].shape
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    points = np.stack([x, y], axis=-1)
    return tuple(  # type: ignore[return-value]
        detailed(cells, scene.grid, texture, points)
        for cells, texture in zip(split(scene), scene.textures, strict=True)
    )


def split(scene: Scene) -> tuple[Array, Array]:
    """Direct and indirect light of the cells; before an off-axis rig direct light does not come
    back where it fell."""
    moved = [effect for effect in scene.effects if isinstance(effect, DisplacedEffect)]
    if not moved:
        return scene.split()
    direct = sum(e.apply(np.ones((1, scene.cells)))[0][:, None] * e.tint for e in moved)
    return np.asarray(direct), scene.white() - direct


def main(path: Path) -> None:
    """Draw all presets, in their order."""
    tiles = []
    for name, options in SCENES:
        build = find_builder(name)
        assert build is not None
        direct, indirect = lights(build(GRID, options))
        shown = [
            average_cells(light / np.percentile(light, WHITE), TILE).reshape(*TILE, 3)
            for light in (direct + indirect, indirect, direct)
        ]
        tiles.append(np.concatenate(shown, axis=1))
    rows = [np.concatenate(tiles[i : i + ACROSS], axis=1) for i in range(0, len(tiles), ACROSS)]
    levels = 255.0 * np.clip(np.concatenate(rows), 0.0, 1.0) ** (1.0 / 2.2)
    save(levels, path)


def save(levels: NDArray[np.floating], path: Path) -> None:
    """Write a picture (H, W, 3) of 0 to 255, rounded to steps of `STEP`."""
    coarse = np.minimum(STEP * np.rint(levels / STEP), 255.0)
    Image.fromarray(coarse.astype(np.uint8)).save(path, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "scenes.png")
