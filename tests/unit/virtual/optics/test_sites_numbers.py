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
from pdcd.panels.placing import Placing
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


def shown(sites: PanelSites, frames: Frames, row: int) -> np.ndarray:
    """What each pixel shows, (height, width)."""
    return sites.levels(frames, row, LINEAR, slice(0, len(sites)))[sites.image]


def test_whole_cells_are_sites_behind_black() -> None:
    sites = sites_of()
    assert len(sites) == 7
    wanted = (1 + np.arange(6).reshape(2, 3)).repeat(4, axis=0).repeat(4, axis=1)
    np.testing.assert_array_equal(sites.image, wanted)
    assert sites.band.tolist() == [0] * 7 and sites.delay_ns.tolist() == [0]
    assert sites.in_band(0) == slice(0, 7)
    assert sites.image.dtype == sites.band.dtype == np.int32


def test_beside_the_field_and_on_dead_lines_a_panel_is_black() -> None:
    image = sites_of(place=Placing(scale=2.0)).image
    assert (image[:2] == 0).all() and (image[:, :3] == 0).all() and image[2, 3] == 1
    white = sites_of(place=Placing(scale=2.0), patterned=False).image
    np.testing.assert_array_equal(white, (image > 0).astype(np.int32))
    dead = sites_of(true=TruePanel(dead_rows=(1, 7), dead_columns=(0,))).image
    expected = sites_of().image.copy()
    expected[[1, 7]] = 0
    expected[:, 0] = 0
    np.testing.assert_array_equal(dead, expected)


def test_a_panel_shows_its_patterns() -> None:
    patterns = np.array([[0.0, 0.2, 0.4, 0.6, 0.8, 1.0], [1.0, 0.0, 0.0, 0.0, 0.0, 0.6]])
    frames = frames_of("whole", patterns, [0, 1, BLACK, WHITE])
    sites = sites_of(true=TruePanel(dead_rows=(0,)))
    wide = patterns.reshape(2, 2, 3).repeat(4, axis=1).repeat(4, axis=2)
    wide[:, 0] = 0.0
    for row in (0, 1):
        np.testing.assert_allclose(shown(sites, frames, row), wide[row], atol=1e-12)
    assert not shown(sites, frames, 2).any() and not shown(sites, frames, -1).any()
    white = shown(sites, frames, 3)
    assert not white[0].any() and (white[1:] == 1.0).all()
    part = sites.levels(frames, 0, LINEAR, slice(2, 4))
    np.testing.assert_allclose(part, [0.2, 0.4])
    squared = sites.levels(frames, 0, make_power_curve(2.0), slice(2, 4))
    np.testing.assert_allclose(squared, [0.04, 0.16])


@pytest.mark.parametrize("shift", [0, 1, 2, 3])
def test_sub_shifts_move_cells_by_half_and_windows_open(shift: int) -> None:
    """Bit 0 moves along columns and bit 1 along rows, towards the origin."""
    levels = np.arange(1, 13) / 15.0  # of a lattice of 3 x 4
    frames = frames_of("quarter", levels[None], [0], [shift])
    moved_down, moved_right = shift >> 1, shift & 1
    half_y, half_x = np.divmod(np.arange(8 * 12).reshape(8, 12), 12)
    half_y, half_x = half_y // 2, half_x // 2
    code = ((half_y + moved_down) >> 1) * 4 + ((half_x + moved_right) >> 1)
    projector = sites_of("quarter")
    np.testing.assert_allclose(shown(projector, frames, 0), levels[code], atol=1e-12)
    # Of the mask the middle of each code cell is open: pixels 1 and 2 of four, or 3 and 0.
    y, x = np.indices((8, 12))
    opened = np.isin(y % 4, (3, 0) if moved_down else (1, 2))
    opened &= np.isin(x % 4, (3, 0) if moved_right else (1, 2))
    mask = sites_of("quarter", mask=True)
    found = shown(mask, frames, 0)
    assert (found[~opened] == 0.0).all()
    np.testing.assert_allclose(found[opened], levels[code][opened], atol=1e-12)


@pytest.mark.parametrize(
    ("scan_s", "bands", "delays"),
    [
        (0.0, 4, [0]),
        (0.006, 1, [0]),
        (0.006, 2, [0, 6_000_000]),
        (-0.006, 4, [6_000_000, 4_000_000, 2_000_000, 0]),
        (0.007, 99, [1_000_000 * n for n in range(8)]),  # no more than there are rows
    ],
)
@pytest.mark.parametrize("place", [Placing(), Placing(scale=1.5), Placing(scale=0.9)])
def test_rows_of_a_band_are_sites_of_their_own(
    scan_s: float, bands: int, delays: list[int], place: Placing
) -> None:
    sites = sites_of(scan_s=scan_s, scan_bands=bands, place=place)
    plain = sites_of(place=place)
    assert sites.delay_ns.tolist() == delays
    count = len(delays)
    row_band = np.arange(8) * count // 8
    assert sites.in_band(0).start == 0 and sites.in_band(count - 1).stop == len(sites)
    assert (np.diff(sites.band) >= 0).all() and sites.band[0] == 0
    lit = sites.image > 0
    np.testing.assert_array_equal(lit, plain.image > 0)
    of_row = np.broadcast_to(row_band[:, None], lit.shape)
    np.testing.assert_array_equal(sites.band[sites.image][lit], of_row[lit])
    for band in range(count):
        part = sites.in_band(band)
        assert (sites.band[part] == band).all()
    # Site 0 is black in every panel, and each pixel shows its own cell.
    frames = frames_of("whole", np.arange(1, 7)[None] / 15.0, [0])
    np.testing.assert_allclose(shown(sites, frames, 0), shown(plain, frames, 0))
    assert sites.levels(frames, 0, LINEAR, slice(0, 1)).tolist() == [0.0]


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
