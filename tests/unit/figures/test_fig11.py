"""Figure 11 in numbers: what is left of the box's front, against dense transport."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.figures.fig11 import FIGURE, left
from pdcd.figures.figure import TINY
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.texture import cell_means
from tests.figures_rig import taken


@pytest.mark.long
def test_one_plane_is_blocked_and_the_others_are_not() -> None:
    photos = taken(FIGURE, ("e", "g"))
    for name, disparity, want in (("e", 0.0, 0.0), ("g", 2.0, 1.0)):
        photo = photos[name]
        options = {"disparity": disparity, "painted": True}
        scene = build_scene(SceneConfig(kind="off-axis-box", grid=TINY.grid, options=options))
        whole = scene.dense()
        keyed = whole.sum(axis=2) - np.diagonal(whole, axis1=1, axis2=2)
        inner = np.zeros(TINY.grid, dtype=bool)
        inner[1:-1, 1:-1] = True
        for image, most in ((photo.truth, 0.15), (photo.image, 0.20)):
            seen = cell_means(np.nan_to_num(image).astype(np.float64), TINY.grid)
            off = (seen - keyed.T)[inner.ravel()]
            assert np.sqrt(np.mean(off**2) / np.mean(keyed.T[inner.ravel()] ** 2)) < most, name
        assert left(photo, disparity) == pytest.approx(want, abs=0.1)
        true = replace(photo, pictures=photo.truths)
        assert left(true, disparity) == pytest.approx(want, abs=0.06)
