"""Panels and pictures that the matrix of pixels refuses, and pixels that cells share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import PanelConfig
from pdcd.errors import ConfigError
from pdcd.panels.frames import FrameLog
from pdcd.panels.pixels import ShownPictures
from pdcd.probing.pixel_matrix import compute_pixel_factors
from pdcd.probing.realised import Factors, collect_factors
from tests.panel_pixels import from_pictures

MS = 1_000_000


def log_of(count: int) -> FrameLog:
    rows = np.arange(count, dtype=np.int32)
    at = 10 * MS * np.arange(count + 1, dtype=np.int64) + 5 * MS
    return FrameLog(
        rows, rows, at[:-1], at[:-1], np.array([at[-1], at[-1]]), 0 * rows, "test", True
    )


def matrix(
    shown: ShownPictures, projector: PanelConfig, mask: PanelConfig, grid: tuple[int, int]
) -> Factors:
    log = log_of(len(shown))
    return collect_factors(
        compute_pixel_factors(shown, log, projector, mask, grid=grid, open_ns=0, close_ns=200 * MS)
    )


def lit(levels: list[list[int]]) -> NDArray[np.uint8]:
    return np.array(levels, dtype=np.uint8)


@pytest.mark.parametrize("defect", [{"scan_s": 0.001}, {"scan_s": -0.001}, {"blur_px": 0.5}])
@pytest.mark.parametrize("side", ["projector", "mask"])
def test_panels_of_which_pixels_do_not_tell_all_are_refused(
    side: str, defect: dict[str, Any]
) -> None:
    plain = PanelConfig(size_px=(2, 1))
    panels = {"projector": plain, "mask": plain}
    panels[side] = PanelConfig(size_px=(2, 1), **defect)
    shown = from_pictures([lit([[255, 0]])], [lit([[255, 0]])])
    with pytest.raises(ConfigError, match="one after the other") as caught:
        matrix(shown, panels["projector"], panels["mask"], (1, 2))
    assert caught.value.device == side


@pytest.mark.parametrize("side", ["projector", "mask"])
def test_pictures_of_another_panel_are_refused(side: str) -> None:
    panels = {"projector": PanelConfig(size_px=(2, 1)), "mask": PanelConfig(size_px=(2, 1))}
    panels[side] = PanelConfig(size_px=(1, 2))
    shown = from_pictures([lit([[255, 0]])], [lit([[255, 0]])])
    with pytest.raises(ConfigError, match="pictures of") as caught:
        matrix(shown, panels["projector"], panels["mask"], (1, 1))
    assert caught.value.device == side


def test_pixels_are_shared_by_the_cells_they_lie_over() -> None:
    """Three pixels of the projector and two of the mask over four cells, one refresh of 10 ms.

    The projector's middle pixel covers the thirds of the field from 1/3 to 2/3, the mask's second
    one its right half: they meet from 1/2 to 2/3, which is the first two thirds of the third cell.
    """
    shown = from_pictures([lit([[0, 255, 0]])], [lit([[0, 255]])])
    got = matrix(shown, PanelConfig(size_px=(3, 1)), PanelConfig(size_px=(2, 1)), (1, 4))
    np.testing.assert_allclose(got.coaxial, [0.0, 0.0, 0.01 * 2 / 3, 0.0], atol=1e-15)
    np.testing.assert_allclose(got.open_s, [0.0, 0.0, 0.01, 0.01], atol=1e-15)
    np.testing.assert_allclose(
        got.dense(), 0.01 * np.outer([0, 0, 1, 1], [0, 2 / 3, 2 / 3, 0]), atol=1e-15
    )


def test_levels_are_light_by_the_curve_of_their_panel() -> None:
    shown = from_pictures([lit([[51]])], [lit([[102]])])
    square = PanelConfig(size_px=(1, 1), gamma=2.0)
    got = matrix(shown, square, PanelConfig(size_px=(1, 1)), (1, 1))
    np.testing.assert_allclose(got.coaxial, [0.01 * 0.04 * 0.4], rtol=1e-12)
    np.testing.assert_allclose(got.open_s, [0.01 * 0.4], rtol=1e-12)
    got = matrix(shown, PanelConfig(size_px=(1, 1)), square, (1, 1))
    np.testing.assert_allclose(got.coaxial, [0.01 * 0.2 * 0.16], rtol=1e-12)
