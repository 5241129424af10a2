"""Where the camera's samples lie on both panels."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, PanelConfig, RigConfig, SceneConfig
from pdcd.bench.truth import BenchTruth
from pdcd.panels.placing import Placing
from pdcd.virtual.optics.setting import OpticalSetting
from pdcd.virtual.optics.sights import CameraSamples

GRID = (24, 32)


@pytest.mark.parametrize("flip", ["none", "horizontal", "vertical"])
@pytest.mark.parametrize("frame", [(113, 150), (96, 128), (90, 100)])
def test_samples_on_the_border_of_a_cell_fall_to_one_side_on_both_panels(
    frame: tuple[int, int], flip: str
) -> None:
    """Where panels and camera lie exactly on each other, samples come to lie exactly on borders;
    rounding must not give one sample the mask of one cell and the light of another."""
    place = Placing(flip=flip)  # type: ignore[arg-type]
    config = Config(
        rig=RigConfig(name="borders"),
        projector=PanelConfig(size_px=(1024, 768)),
        mask=PanelConfig(size_px=(1600, 1200)),
        camera=CameraConfig(place=place, frame_quads=(frame[1], frame[0])),
        scene=SceneConfig(grid=GRID),
    )
    looks = CameraSamples(OpticalSetting(config, BenchTruth(), frame))
    apart = 0
    for chunk in looks.chunks():
        on_mask, on_projector = looks.on_mask(chunk), looks.on_projector(chunk, 0)
        for axis, cells in enumerate(GRID[::-1]):
            mask = np.floor(on_mask[axis] * cells / (1600, 1200)[axis])
            lit = np.floor(on_projector[axis] * cells / (1024, 768)[axis])
            apart += int(np.sum(mask != lit))
    assert apart == 0
