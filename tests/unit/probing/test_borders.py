"""Borders of cells that both panels draw, and the window that bears how far they are apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config, PanelConfig, RigConfig
from pdcd.panels.placing import Placing
from pdcd.panels.windows import find_window_kind
from pdcd.planning.bench_fit import choose_grid_window
from pdcd.probing.borders import (
    ACROSS,
    cell_mismatch_px,
    compute_cell_mismatch_share,
    find_nearest_grid,
)

GRID = (24, 32)


def config(projector: tuple[int, int], mask: tuple[int, int], **placed: Any) -> Config:
    return Config(
        rig=RigConfig(name="borders"),
        projector=PanelConfig(size_px=projector),
        mask=PanelConfig(size_px=mask, place=Placing(**placed)),
    )


def apart(rig: Config, grid: tuple[int, int] = GRID) -> tuple[float, float]:
    """How far, in pixels, and in which share of the field they draw different cells."""
    panels = panels_of(rig)
    return (
        cell_mismatch_px(panels.projector, panels.mask, grid, rig.projector.size_px),
        compute_cell_mismatch_share(panels.projector, panels.mask, grid),
    )


@pytest.mark.parametrize(
    "rig",
    [
        config((512, 384), (800, 600)),
        config((512, 384), (800, 600), flip="horizontal"),
        config((512, 384), (800, 600), turn_deg=180.0),
        config((500, 375), (500, 375)),  # cells that end within a pixel, of equal panels
    ],
)
def test_panels_whose_pixels_meet_take_whole_cells(rig: Config) -> None:
    assert apart(rig) == (0.0, 0.0)
    assert choose_grid_window("auto", rig, GRID) == "whole"


@pytest.mark.parametrize(
    "rig",
    [
        config((512, 384), (500, 375)),  # which nobody placed
        config((512, 384), (801, 600)),
        config((512, 384), (800, 600), turn_deg=2.0, scale=1.05),
        config((512, 384), (500, 375), turn_deg=180.0),
        config((512, 384), (801, 600), flip="vertical"),
        config((512, 384), (800, 600), offset_px=(0.4, 0.0)),
        config((512, 384), (400, 300), turn_deg=31.0, scale=1.4),
    ],
)
def test_all_others_take_quarter_windows_which_bear_what_is_drawn(rig: Config) -> None:
    """Looked at in another way: at many places of the field by chance, both panels' pixels. Where
    they show different cells no window of the mask may be open under another cell's light."""
    found = find_window_kind(choose_grid_window("auto", rig, GRID))
    assert found.name == "quarter"
    rng = np.random.Generator(np.random.PCG64(5))
    points = rng.uniform(0.0, 1.0, (60_000, 2))
    panels = panels_of(rig)
    centres = []
    for view in (panels.projector, panels.mask):
        pixel = np.floor(view.map.from_field(points))
        on = np.all((pixel >= 0) & (pixel < view.size_px), axis=1, keepdims=True)
        centres.append(np.where(on, view.map.to_field(pixel + 0.5), np.nan))
    lit, opened = (centre * GRID[::-1] for centre in centres)
    both = np.isfinite(lit + opened).all(axis=1)
    differ = both & (np.floor(lit) != np.floor(opened)).any(axis=1)
    assert differ.any()
    assert apart(rig)[1] == pytest.approx(differ.mean(), rel=0.1)
    within = np.abs(opened % 1.0 - 0.5).max(axis=1) <= 0.5 - found.guard  # the window of its cell
    assert not (differ & within).any()


@pytest.mark.parametrize(
    ("rig", "window"),
    [
        (config((512, 384), (1024, 768)), "whole"),  # borders are drawn alike
        (config((512, 384), (801, 600)), "whole"),
        (config((64, 48), (100, 75)), "quarter"),  # two pixels a cell
        (config((512, 384), (400, 300), turn_deg=31.0, scale=1.4), "quarter"),
    ],
)
def test_whole_cells_are_taken_where_little_is_left_of_what_is_taken_out(
    rig: Config, window: str
) -> None:
    assert choose_grid_window("auto", rig, GRID, taken_out=True) == window


@pytest.mark.parametrize(
    ("projector", "mask", "grid", "wanted"),
    [
        ((1024, 768), (1600, 1200), (36, 48), (48, 64)),  # 64 and 48 divide both
        ((1024, 768), (1600, 1200), (20, 30), (24, 32)),
        ((1024, 768), (1600, 1200), (24, 32), (24, 32)),
        ((1024, 768), (1600, 1200), (48, 130), None),  # at most 64 columns, half of these
        ((1021, 769), (1600, 1200), (24, 32), None),  # nothing divides both but 1
    ],
)
def test_the_nearest_cells_that_end_on_the_pixels_of_both_panels(
    projector: tuple[int, int],
    mask: tuple[int, int],
    grid: tuple[int, int],
    wanted: tuple[int, int] | None,
) -> None:
    panels = panels_of(config(projector, mask))
    assert find_nearest_grid(panels.projector, panels.mask, grid) == wanted
    if wanted is not None:
        assert all(size[1] % wanted[0] == 0 == size[0] % wanted[1] for size in (projector, mask))


SIZE = (512, 384)
STEP_PX = 2.0 * 2.0 * 0.5**0.5 / ACROSS
"""How finely it is looked: twice half a pixel each way, over so many places."""


@pytest.mark.parametrize("by_px", [0.2, 0.4, -0.3, -0.45])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_mask_that_lies_beside_its_place_draws_borders_there(axis: int, by_px: float) -> None:
    """Cells end at pixels of the projector; the mask's pixels end so much further."""
    grid, offset = ((1, 32), (by_px, 0.0)) if axis == 0 else ((24, 1), (0.0, by_px))
    found_px, share = apart(config(SIZE, SIZE, offset_px=offset), grid)
    assert abs(by_px) - STEP_PX <= found_px <= abs(by_px)
    borders = grid[1 - axis] - 1
    assert share == pytest.approx(borders * abs(by_px) / SIZE[axis], rel=0.02)


@pytest.mark.parametrize("by_px", [0.2, 0.4])
@pytest.mark.parametrize("axis", [0, 1])
def test_corners_do_not_widen_what_lies_beside_one_border(axis: int, by_px: float) -> None:
    """Near a corner the panels differ across the other border, too, however far this one is."""
    offset = (by_px, 0.0) if axis == 0 else (0.0, by_px)
    found_px, _ = apart(config(SIZE, SIZE, offset_px=offset))
    assert by_px - STEP_PX <= found_px <= by_px


@pytest.mark.parametrize(
    ("grid", "offset", "seen"),
    [
        ((1, 1), (0.4, 0.4), False), ((1, 32), (0.4, 0.0), True), ((1, 32), (0.0, 0.4), False),
        ((24, 1), (0.0, 0.4), True), ((24, 1), (0.4, 0.0), False), ((1, 2), (0.4, 0.0), True),
    ],
)  # fmt: skip
def test_only_borders_that_there_are_can_be_apart(
    grid: tuple[int, int], offset: tuple[float, float], seen: bool
) -> None:
    found_px, share = apart(config(SIZE, SIZE, offset_px=offset), grid)
    assert (found_px > 0.0) is (share > 0.0) is seen
