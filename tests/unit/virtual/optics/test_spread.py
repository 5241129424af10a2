"""What of a cell each pixel of the projector lights, against areas worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.bench.tables import PanelConfig, SceneConfig
from pdcd.bench.truth import BenchTruth, TruePanel
from pdcd.panels.placing import Placing
from pdcd.virtual.optics import spread as spread_module
from pdcd.virtual.optics.setting import OpticalSetting
from pdcd.virtual.optics.spread import LitCellPoints
from tests.unit.virtual.optics.test_bench import config_of

PX = (320, 240)


def lit_cells(grid: tuple[int, int], turn_deg: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Shares of cells by pixels, (rows, cols) each: down and across, summed over the other axis."""
    panel = PanelConfig(size_px=PX)
    config = config_of(projector=panel, mask=panel, scene=SceneConfig(grid=grid))
    truth = BenchTruth(projector=TruePanel(place=Placing(turn_deg=turn_deg)))
    found = LitCellPoints.of(OpticalSetting(config, truth, (240, 320)), grid)
    shares = np.zeros((grid[0] * grid[1], PX[1], PX[0]))
    np.add.at(shares.reshape(len(shares), -1), (found.cell, found.pixel), found.share)
    return shares.sum(axis=2), shares.sum(axis=1)


def overlap(cells: int, pixels: int) -> np.ndarray:
    """Share of each of so many cells in a row that each pixel covers."""
    low = np.maximum(np.arange(cells)[:, None] / cells, np.arange(pixels) / pixels)
    high = np.minimum(np.arange(1, cells + 1)[:, None] / cells, np.arange(1, pixels + 1) / pixels)
    return np.asarray(np.maximum(high - low, 0.0) * cells)


@pytest.mark.parametrize("grid", [(3, 4), (1, 24), (18, 1), (1, 5), (2, 40)])
def test_cells_of_any_form_are_lit_by_what_lies_on_them(grid: tuple[int, int]) -> None:
    """A pixel that lies in two cells is told to a 32nd of a cell."""
    down, across = lit_cells(grid)
    rows, cols = np.divmod(np.arange(grid[0] * grid[1]), grid[1])
    np.testing.assert_allclose(down, overlap(grid[0], PX[1])[rows], atol=1 / 32)
    np.testing.assert_allclose(across, overlap(grid[1], PX[0])[cols], atol=1 / 32)
    np.testing.assert_allclose(down.sum(axis=1), 1.0)


@pytest.mark.parametrize("turn_deg", [90.0, 30.0])
def test_long_cells_before_a_turned_projector_are_lit_as_many_points_tell(
    turn_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = lit_cells((1, 24), turn_deg)
    monkeypatch.setattr(spread_module, "_POINTS_PER_PX", 16)
    for found, wanted in zip(few, lit_cells((1, 24), turn_deg), strict=True):
        assert wanted.max() > 0.0
        np.testing.assert_allclose(found, wanted, atol=1 / 32)
