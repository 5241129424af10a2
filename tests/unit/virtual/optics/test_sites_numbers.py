"""Sites of a panel and their histories: numbers by hand, bands of rows, dead lines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import PanelConfig, SceneConfig
from pdcd.bench.truth import BenchTruth, TruePanel
from pdcd.panels.curve import make_power_curve
from pdcd.panels.frames import BLACK, PIXEL_WINDOW, WHITE, Frames
from pdcd.virtual.optics import histories as histories_module
from pdcd.virtual.optics.histories import Histories
from pdcd.virtual.optics.setting import OpticalSetting
from pdcd.virtual.optics.sites import PanelSites, SiteKind
from tests.unit.virtual.optics.test_bench import config_of

GRID = (2, 3)
LINEAR = make_power_curve(1.0)


def sites_of(*, mask: bool = False, **panel: Any) -> PanelSites:
    """The sites of 4 x 2 pixels."""
    one = PanelConfig(size_px=(4, 2), **panel)
    config = config_of(projector=one, mask=one, scene=SceneConfig(grid=GRID))
    setting = OpticalSetting(config, BenchTruth(), (4, 4))
    name = "mask" if mask else "projector"
    view, timed = getattr(setting.drawn, name), getattr(setting.true, name)
    return PanelSites(view, SiteKind(GRID, PIXEL_WINDOW, True), TruePanel(), timed)


def pixel_frames() -> Frames:
    """Three patterns of 4 x 2 pixels on both panels; of the eight pixels three pairs are alike
    throughout."""
    rows = [[0, 1, 1, 0, 0.4, 0.4, 1, 0.2], [1, 0, 0, 1, 0, 0, 1, 1], [0, 0, 0, 0, 0.6, 0.6, 1, 0]]
    patterns, index = np.array(rows, np.float32), np.array([0, 1, 2, WHITE, BLACK], np.int32)
    return Frames(
        patterns, patterns, index, index, np.zeros(5, np.uint8), index, np.zeros(5, np.bool_),
        GRID, GRID, PIXEL_WINDOW,
    )  # fmt: skip


@pytest.mark.parametrize("mask", [True, False])
@pytest.mark.parametrize("limit", [1 << 54, 1])
def test_pixels_that_show_the_same_have_one_history(
    mask: bool, limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(histories_module, "KEY_LIMIT", limit)
    sites, frames = sites_of(mask=mask), pixel_frames()
    histories = Histories(sites, frames, mask=mask)
    assert len(histories) == 6  # five kinds of pixels, and black
    groups = [np.flatnonzero(histories.of == one).tolist() for one in range(6)]
    assert sorted(groups) == [[0], [1, 4], [2, 3], [5, 6], [7], [8]]
    bytes_sent = np.rint(255.0 * frames.dual_patterns.astype(np.float64)) / 255.0
    asked = [*bytes_sent, np.ones(8), np.zeros(8), np.zeros(8)]
    for row, pixels in zip((0, 1, 2, 3, 4, -1), asked, strict=True):
        every = np.append(0.0, pixels)  # behind what is black throughout
        found = histories.levels(frames, row, LINEAR, slice(0, 6))
        np.testing.assert_allclose(found[histories.of], every)
    np.testing.assert_allclose(
        histories.levels(frames, 0, make_power_curve(2.0), slice(1, 3)),
        histories.levels(frames, 0, LINEAR, slice(0, 6))[1:3] ** 2, atol=1e-12,
    )  # fmt: skip
    assert histories.band.tolist() == [0] * 6 and histories.in_band(0) == slice(0, 6)


def test_histories_of_late_rows_are_their_own() -> None:
    sites = sites_of(scan_s=0.001, scan_bands=2)
    histories = Histories(sites, pixel_frames(), mask=False)
    assert (np.diff(histories.band) >= 0).all() and histories.delay_ns.tolist() == [0, 1_000_000]
    np.testing.assert_array_equal(histories.band[histories.of], sites.band)
    assert histories.in_band(0).stop == histories.in_band(1).start
    # Black, and two and three kinds of pixels.
    assert histories.in_band(1).stop == len(histories) == 6
    np.testing.assert_array_equal(histories.tile, histories.band)
