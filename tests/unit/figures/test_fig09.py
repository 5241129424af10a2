"""Figure 9 in numbers: both photos and their difference against dense transport."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.figures.fig09 import FIGURE, SCENE, contrasts
from pdcd.figures.figure import TINY
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.texture import cell_means
from tests.figures_rig import numbers_of, taken

P = 1.0 / 8.0


@pytest.mark.long
def test_the_difference_of_both_photos_is_direct_light_less_that_from_the_left() -> None:
    photos = taken(FIGURE)
    rows, cols = TINY.grid
    whole = build_scene(SceneConfig(kind=SCENE, grid=TINY.grid)).dense().sum(axis=0) / 3.0
    cells = np.arange(rows * cols)
    inner = cells % cols > 0
    own = whole[cells, cells]
    beside = np.where(inner, whole[cells, cells - 1], 0.0)
    want = {
        "ours c": own + P * (whole.sum(axis=1) - own),
        "ours d": beside + P * (whole.sum(axis=1) - beside),
    }
    # Away from the border of the field, where a raster of 100 pixels has unknown ones.
    middle = inner & (cells % cols < cols - 1) & (cells // cols > 0) & (cells // cols < rows - 1)
    seen = {}
    for name, light in want.items():
        image = np.nan_to_num(photos[name].image).mean(axis=-1, keepdims=True)
        seen[name] = cell_means(image, TINY.grid)[:, 0]
        # Away from the border of the field, where a raster of 100 pixels has unknown ones.
        middle = (
            (cells // cols > 0) & (cells // cols < rows - 1) & inner & (cells % cols < cols - 1)
        )
        off = (seen[name] - light)[middle]
        assert np.sqrt(np.mean(off**2) / np.mean(light[middle] ** 2)) < 0.13, name
    difference = (seen["ours c"] - seen["ours d"])[middle] / (1.0 - P)
    off = difference - (own - beside)[middle]
    assert np.sqrt(np.mean(off**2) / np.mean((own - beside)[middle] ** 2)) < 0.20
    numbers = numbers_of(FIGURE, photos)
    assert numbers["RMS error of (e), our codes"] < numbers["RMS error of (e), the paper's codes"]


def test_contrast_is_that_of_two_greys() -> None:
    flat = np.full((300, 400, 3), 0.5)
    np.testing.assert_allclose(contrasts(flat)[:3], 0.0, atol=1e-12)
    half = build_scene(SceneConfig(kind=SCENE, grid=(12, 16))).texture
    assert half is not None
    # Ink of 0.05 on paper of 0.86, before there is milk.
    assert contrasts(half)[0] == pytest.approx((0.86 - 0.05) / (0.86 + 0.05), abs=0.02)
