"""When a mock bench is one of pixels: wherever they show something else than cells do."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import Config, PanelConfig, SceneConfig
from pdcd.capture.rig import Rig
from pdcd.panels.frames import Frames
from pdcd.panels.patterns import pack_bits
from pdcd.virtual.optics.needed import choose_optics
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.effects import make_direct_effects
from pdcd.virtual.scene.scene import Scene
from tests.unit.virtual.optics.test_bench import exposure_of


def config_of(grid: tuple[int, int], projector: tuple[int, int], mask: tuple[int, int]) -> Config:
    return Config(
        projector=PanelConfig(size_px=projector),
        mask=PanelConfig(size_px=mask),
        scene=SceneConfig(kind="card", grid=grid),
    )


@pytest.mark.parametrize(
    ("grid", "window", "pixels"),
    [
        ((48, 64), "whole", False),  # 16 and 25 pixels a cell
        ((24, 32), "whole", False),
        ((12, 16), "quarter", False),  # 64 and 100
        ((36, 48), "whole", True),  # 21.33 and 33.33
        ((96, 128), "whole", True),  # 8 and 12.5: the mask's own edges lie within cells
        ((48, 64), "quarter", True),  # windows of 6.25 pixels
        ((48, 64), "side-3/4", True),
        ((12, 16), "side-5/8", True),  # ends at 18.75
    ],
)  # fmt: skip
def test_cells_say_it_all_where_edges_are_edges_of_pixels(
    grid: tuple[int, int], window: str, pixels: bool
) -> None:
    config = config_of(grid, (1024, 768), (1600, 1200))
    scene = build_scene(config.scene)
    assert (choose_optics(config, scene, (window,)) is not None) is pixels


def test_light_goes_through_the_mask_of_the_next_cell_where_pixels_say_so() -> None:
    """Six pixels for four cells: 0 1 1 2 3 3 are the cells that their centres fall in. Cell 1 is
    lit from 1/6 to 1/2 of the field, of which 1/12, a third of a cell, lies in cell 0."""
    config = config_of((1, 4), (6, 2), (400, 100))
    scene = Scene("s", (1, 4), tuple(make_direct_effects(np.ones((4, 3)))))
    lit, opened = (np.arange(4) == cell for cell in (1, 0))
    index = np.zeros(1, np.int32)
    frames = Frames(
        pack_bits(lit[None]), pack_bits(opened[None]), index, index, index.astype(np.uint8), index,
        index.astype(np.bool_), (1, 4), (1, 4), "whole",
    )  # fmt: skip
    bench = choose_optics(config, scene)
    assert bench is not None
    light = bench.photo(exposure_of(frames))[0, :, 1] * 60.0
    np.testing.assert_allclose(light, [1.0 / 3.0, 0.0, 0.0, 0.0], atol=0.02)


@pytest.mark.parametrize(("grid", "meet"), [((6, 8), True), ((6, 5), False)])
def test_a_rig_says_whether_anything_can_be_misplaced(grid: tuple[int, int], meet: bool) -> None:
    config = config_of(grid, (64, 48), (80, 60))
    assert Rig(config)._context.shared.cells_meet is meet
    assert not DriverContext(config=config, clock=VirtualClock()).shared.cells_meet
