"""Figure 12 in numbers: what stays in the mirror, against the diagonal of dense transport."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.figures.fig12 import FIGURE, MIRROR, left, retro
from pdcd.figures.figure import TINY
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.presets.canvas import Raster
from pdcd.virtual.scene.presets.vase import on_glass
from tests.figures_rig import taken


@pytest.mark.long
def test_the_mirror_keeps_what_it_took_back_itself_and_nothing_else() -> None:
    (photo,) = taken(FIGURE, (f"{MIRROR}, ours",)).values()
    whole = build_scene(SceneConfig(kind=MIRROR, grid=TINY.grid)).dense().sum(axis=0)
    glass = on_glass(Raster(TINY.grid), -0.06).ravel()
    want = np.diagonal(whole)[glass].sum() / whole.sum(axis=1)[glass].sum()
    assert 0.1 < want < 0.7
    assert retro(photo.truths) == pytest.approx(want, abs=0.10)
    assert retro(photo.pictures) == pytest.approx(retro(photo.truths), abs=0.06)
    assert abs(left(photo)) < 0.15
    # The number sees what it is for: a photo whose codes did nothing has all of it left.
    bad = {**photo.pictures, "direct": photo.pictures["white"]}
    assert left(replace(photo, pictures=bad)) == pytest.approx(1.0, abs=0.1)
