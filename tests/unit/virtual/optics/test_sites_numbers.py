"""Sites of a panel and their histories: numbers by hand, bands of rows, dead lines."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import Config, PanelConfig, SceneConfig
from pdcd.bench.truth import BenchTruth, TruePanel
from pdcd.panels.curve import make_power_curve
from pdcd.panels.frames import BLACK, PIXEL_WINDOW, WHITE, Frames
from pdcd.virtual.optics import histories as histories_module
from pdcd.virtual.optics.histories import Histories
from pdcd.virtual.optics.setting import OpticalSetting
from pdcd.virtual.optics.sites import PanelSites, SiteKind

GRID = (2, 3)
LINEAR = make_power_curve(1.0)


def sites_of(
    window: str = "whole", size: tuple[int, int] = (12, 8), *, mask: bool = False,
    patterned: bool = True, true: TruePanel | None = None, **panel: Any,
) -> PanelSites:  # fmt: skip
    config = msgspec.structs.replace(
        Config(), projector=PanelConfig(size_px=size), scene=SceneConfig(grid=GRID)
    )
    config = msgspec.structs.replace(config, mask=PanelConfig(size_px=size))
    name = "mask" if mask else "projector"
    config = msgspec.structs.replace(config, **{name: PanelConfig(size_px=size, **panel)})
    setting = OpticalSetting(config, BenchTruth(), (4, 4))
    view, timed = getattr(setting.drawn, name), getattr(setting.true, name)
    return PanelSites(view, SiteKind(GRID, window, patterned), true or TruePanel(), timed)


def frames_of(
    window: str, patterns: np.ndarray, index: list[int], shift: list[int] | None = None
) -> Frames:
    """The same patterns on both panels."""
    count, more = len(index), int(window not in ("whole", PIXEL_WINDOW))
    numbers = np.array(index, np.int32)
    return Frames(
        patterns.astype(np.float32), patterns.astype(np.float32), numbers, numbers,
        np.array(shift or [0] * count, np.uint8), numbers, np.zeros(count, np.bool_), GRID,
        (GRID[0] + more, GRID[1] + more), window,
    )  # fmt: skip


def pixel_frames() -> Frames:
    """Three patterns of 4 x 2 pixels; of the eight pixels three pairs are alike throughout."""
    rows = [[0, 1, 1, 0, 0.4, 0.4, 1, 0.2], [1, 0, 0, 1, 0, 0, 1, 1], [0, 0, 0, 0, 0.6, 0.6, 1, 0]]
    return frames_of(PIXEL_WINDOW, np.array(rows), [0, 1, 2, WHITE, BLACK])


@pytest.mark.parametrize("mask", [True, False])
@pytest.mark.parametrize("limit", [1 << 54, 1 << 10, 1])
def test_pixels_that_show_the_same_have_one_history(
    mask: bool, limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(histories_module, "KEY_LIMIT", limit)
    sites, frames = sites_of(PIXEL_WINDOW, (4, 2), mask=mask), pixel_frames()
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
    sites = sites_of(PIXEL_WINDOW, (4, 2), scan_s=0.001, scan_bands=2)
    histories = Histories(sites, pixel_frames(), mask=False)
    assert (np.diff(histories.band) >= 0).all() and histories.delay_ns.tolist() == [0, 1_000_000]
    np.testing.assert_array_equal(histories.band[histories.of], sites.band)
    assert histories.in_band(0).stop == histories.in_band(1).start
    # Black, and two and three kinds of pixels.
    assert histories.in_band(1).stop == len(histories) == 6
    np.testing.assert_array_equal(histories.tile, histories.band)
