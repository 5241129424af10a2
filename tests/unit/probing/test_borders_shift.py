"""Borders of equal panels that lie a part of a pixel apart: by how much is known."""

from __future__ import annotations

import pytest

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config, PanelConfig, RigConfig
from pdcd.panels.placing import Placing
from pdcd.probing.borders import ACROSS, cell_mismatch_px, compute_cell_mismatch_share

SIZE = (512, 384)
STEP_PX = 2.0 * 2.0 * 0.5**0.5 / ACROSS
"""How finely it is looked: twice half a pixel each way, over so many places."""


def apart(offset_px: tuple[float, float], grid: tuple[int, int]) -> tuple[float, float]:
    rig = Config(
        rig=RigConfig(name="shifted"),
        projector=PanelConfig(size_px=SIZE),
        mask=PanelConfig(size_px=SIZE, place=Placing(offset_px=offset_px)),
    )
    panels = panels_of(rig)
    return (
        cell_mismatch_px(panels.projector, panels.mask, grid, SIZE),
        compute_cell_mismatch_share(panels.projector, panels.mask, grid),
    )


@pytest.mark.parametrize("by_px", [0.2, 0.4, -0.3, -0.45])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_mask_that_lies_beside_its_place_draws_borders_there(axis: int, by_px: float) -> None:
    """Cells end at pixels of the projector; the mask's pixels end so much further."""
    grid, offset = ((1, 32), (by_px, 0.0)) if axis == 0 else ((24, 1), (0.0, by_px))
    found_px, share = apart(offset, grid)
    assert abs(by_px) - STEP_PX <= found_px <= abs(by_px)
    borders = grid[1 - axis] - 1
    assert share == pytest.approx(borders * abs(by_px) / SIZE[axis], rel=0.02)


@pytest.mark.parametrize("by_px", [0.2, 0.4])
@pytest.mark.parametrize("axis", [0, 1])
def test_corners_do_not_widen_what_lies_beside_one_border(axis: int, by_px: float) -> None:
    """Near a corner the panels differ across the other border, too, however far this one is."""
    found_px, _ = apart((by_px, 0.0) if axis == 0 else (0.0, by_px), (24, 32))
    assert by_px - STEP_PX <= found_px <= by_px


@pytest.mark.parametrize(
    ("grid", "offset", "seen"),
    [
        ((1, 1), (0.4, 0.4), False),
        ((1, 32), (0.4, 0.0), True),
        ((1, 32), (0.0, 0.4), False),
        ((24, 1), (0.0, 0.4), True),
        ((24, 1), (0.4, 0.0), False),
        ((1, 2), (0.4, 0.0), True),
    ],
)
def test_only_borders_that_there_are_can_be_apart(
    grid: tuple[int, int], offset: tuple[float, float], seen: bool
) -> None:
    found_px, share = apart(offset, grid)
    assert (found_px > 0.0) is (share > 0.0) is seen
