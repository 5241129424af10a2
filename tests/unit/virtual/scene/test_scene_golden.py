"""Virtual scenes look as they did when the bounds of figures and benchmarks were stated on them.

`tests/data/scenes.npz` has what cells send and the textures' contrast, coarsely: rounding of
another machine passes, and whatever an eye would see does not. Where a scene is changed on purpose,
write it anew by ``python -m tests.unit.virtual.scene.test_scene_golden``, and look at the figures
again. `tests/data/letters.npz` has the ink of each row and column of each letter of the font.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.virtual.scene.presets import find_builder, letters, list_presets
from pdcd.virtual.scene.scene import Scene
from tests.places import DATA

GRID = (12, 16)
GOLDEN = DATA / "scenes.npz"
NEAR = 2e-3
"""Largest difference over the RMS of a picture: less than an eye sees."""


def built(kind: str) -> Scene:
    build = find_builder(kind)
    assert build is not None
    return build(GRID, {})


def cells(kind: str) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """What cells send of direct and of indirect light, and of light from a few single ones."""
    scene = built(kind)
    yield from zip(("direct", "indirect"), scene.split(), strict=True)
    light = np.zeros((4, scene.cells))
    light[np.arange(4), np.array([20, 70, 105, 150])] = 1.0
    seen = scene.apply(light)
    yield "paths", seen.sum(axis=2)
    if scene.displacement is not None:
        yield "displacement", np.nan_to_num(scene.displacement, nan=99.0)


def contrast(kind: str) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Of textures, over blocks of 64 x 64 pixels: mean and deviation, over the mean of all."""
    textures = built(kind).textures or ()
    for name, texture in zip(("texture", "indirect texture"), textures, strict=False):
        blocks = texture.reshape(12, 64, 16, 64, 3)
        whole = float(texture.mean())
        yield f"{name}, mean", blocks.mean(axis=(1, 3)) / whole
        yield f"{name}, deviation", blocks.std(axis=(1, 3)) / whole


def same(found: Iterator[tuple[str, NDArray[np.float64]]], kind: str) -> None:
    with np.load(GOLDEN) as golden:
        for name, values in found:
            wanted = golden[f"{kind}: {name}"].astype(np.float64)
            scale = max(float(np.sqrt(np.mean(wanted**2))), 1e-9)
            assert values.shape == wanted.shape
            assert np.abs(values - wanted).max() <= NEAR * scale, f"{kind}: {name}"


@pytest.mark.parametrize("kind", list_presets())
def test_cells_of_a_scene_send_what_they_did(kind: str) -> None:
    same(cells(kind), kind)


DEAR = ("still-life", "glass-and-balls", "ball-wax-book", "disco-ball")
"""Scenes whose light is followed ray by ray."""


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=pytest.mark.long) if k in DEAR else k for k in list_presets()],
)
def test_textures_of_a_scene_have_the_contrast_that_they_had(kind: str) -> None:
    same(contrast(kind), kind)


LETTERS = DATA / "letters.npz"
SIZE_PX = 24.0
NEAR_INK = 0.02
"""Of a pixel's ink."""


def profiles(letter: str) -> NDArray[np.float64]:
    """Ink of each row, and then of each column."""
    image = letters.draw_text_line(letter, SIZE_PX).astype(np.float64)
    return np.concatenate([image.sum(axis=1), image.sum(axis=0)])


@pytest.mark.parametrize("letter", sorted(letters.STROKES))
def test_a_letter_looks_as_it_did(letter: str) -> None:
    with np.load(LETTERS) as golden:
        wanted = golden[f"ink of {ord(letter)}"].astype(np.float64)
    found = profiles(letter)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() <= NEAR_INK


if __name__ == "__main__":
    kept = {
        f"{kind}: {name}": values.astype(np.float32)
        for kind in list_presets()
        for made in (cells, contrast)
        for name, values in made(kind)
    }
    np.savez_compressed(GOLDEN, **kept)  # type: ignore[arg-type]
    inked = {f"ink of {ord(letter)}": profiles(letter) for letter in letters.STROKES}
    np.savez_compressed(LETTERS, **{n: v.astype(np.float32) for n, v in inked.items()})  # type: ignore[arg-type]
