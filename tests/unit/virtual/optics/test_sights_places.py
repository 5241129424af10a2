"""Points among pixels, cells and runs: by hand, and at the edges of what has them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, PanelConfig, SceneConfig
from pdcd.bench.truth import BenchTruth
from pdcd.panels.placing import Placing
from pdcd.virtual.optics import sights as sights_module
from pdcd.virtual.optics.setting import OpticalSetting
from pdcd.virtual.optics.sights import (
    NO_SITE,
    CameraSamples,
    CellGrid,
    ScatteredSamples,
    find_sights,
    sample_pixels,
)
from pdcd.virtual.optics.sites import PanelSites, SiteKind
from tests.unit.virtual.optics.test_bench import config_of

PANEL = PanelConfig(size_px=(12, 9))


def setting_of(**more: Any) -> OpticalSetting:
    config = config_of(**{"projector": PANEL, "mask": PANEL, **more})
    return OpticalSetting(config, BenchTruth(), (4, 5))


@pytest.mark.parametrize("grid", [(2, 3), (1, 1), (4, 2)])
def test_between_the_centres_of_cells_values_lie_on_lines(grid: tuple[int, int]) -> None:
    """Beyond the outermost centres they stay as they are there."""
    rows, cols = grid
    cells, rng = CellGrid(grid, smooth=True), np.random.default_rng(1)
    values = rng.random(rows * cols)
    x, y = rng.random(200), rng.random(200)
    at, shares = cells.at(x, y), cells.shares(x.copy(), y.copy())
    assert cells.places == (rows + 1) * (cols + 1) == len(cells.corners)
    assert at.min() >= 0 and at.max() < cells.places
    found = (values[cells.corners[at]] * shares).sum(axis=1)
    table = values.reshape(grid)
    lines = [np.interp(x * cols - 0.5, np.arange(cols), row) for row in table]
    down = np.clip(y * rows - 0.5, 0.0, rows - 1.0)
    first = np.minimum(down.astype(int), max(rows - 2, 0))
    part = down - first
    upper, lower = (
        np.array(lines)[first, range(200)],
        np.array(lines)[np.minimum(first + 1, rows - 1), range(200)],
    )
    np.testing.assert_allclose(found, (1.0 - part) * upper + part * lower, atol=1e-12)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)


def test_scattered_samples_lie_evenly_and_each_in_its_share_of_a_quad() -> None:
    setting = OpticalSetting(setting_of().believed, BenchTruth(), (40, 50))
    count = setting.samples
    raster, scattered = (
        np.stack(looks.on_field((0, 40))) * [[50.0 * count], [40.0 * count]]
        for looks in (CameraSamples(setting), ScatteredSamples(setting))
    )
    aside = scattered - raster
    assert np.abs(aside).max() <= 0.5 + 1e-6
    # As evenly beside their places as 8 x 8 parts of a share can be filled.
    part = np.clip((8 * (aside + 0.5)).astype(int), 0, 7)
    filled = np.bincount(part[0] * 8 + part[1], minlength=64)
    assert filled.max() < 1.2 * filled.min()
    parts = [ScatteredSamples(setting).on_field((row, row + 8)) for row in range(0, 40, 8)]
    whole = np.stack(ScatteredSamples(setting).on_field((0, 40)))
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole)


@pytest.mark.parametrize("blur", [0.0, 1.5])
@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.parametrize("chunk", [1 << 16, 50])
def test_each_sample_has_its_sight(
    blur: float, masked: bool, chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The site of either panel and the cell, or nowhere, of every sample and tap."""
    monkeypatch.setattr(sights_module, "CHUNK_SAMPLES", chunk)
    mask_config = PanelConfig(size_px=(12, 9), blur_px=blur, place=Placing(scale=0.8))
    camera = CameraConfig(place=Placing(turn_deg=5.0, scale=1.3))
    setting = setting_of(mask=mask_config, camera=camera)
    truth, true = setting.truth, setting.true
    kind = SiteKind((3, 4), "quarter", True)
    lit = PanelSites(setting.drawn.projector, kind, truth.projector, true.projector)
    mask = PanelSites(setting.drawn.mask, kind, truth.mask, true.mask)
    cells, looks = CellGrid((3, 4), smooth=False), CameraSamples(setting)
    sights = find_sights(looks, setting, cells, lit, mask if masked else None)
    assert len({*zip(sights.mask, sights.lit, sights.place, strict=True)}) == len(sights.mask)
    assert len(sights.runs) == len(list(looks.chunks()))
    for number, span in enumerate(looks.chunks()):
        x, y = looks.on_field(span)
        assert len(sights.runs[number]) == len(setting.taps)
        for which, (tap, runs) in enumerate(zip(setting.taps, sights.runs[number], strict=True)):
            sight = runs.spread(x.size)
            before = sample_pixels(mask.image, *looks.on_mask(span), missing=0)
            np.testing.assert_array_equal(sights.mask[sight], before if masked else 0 * before)
            behind = sample_pixels(lit.image, *looks.on_projector(span, which), missing=NO_SITE)
            np.testing.assert_array_equal(sights.lit[sight], behind)
            place = cells.at(x + tap.offset[0], y + tap.offset[1])
            np.testing.assert_array_equal(sights.place[sight], place)
    assert (sights.lit == NO_SITE).any() and (sights.place == NO_SITE).any()


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize(
    ("x", "y"), [(1.0, 0.5), (0.5, 1.0), (-1e-9, 0.5), (0.5, -1e-9), (np.nan, 0.5), (0.5, np.nan)]
)
def test_beside_the_field_there_is_no_cell(x: float, y: float, smooth: bool) -> None:
    cells = CellGrid((2, 3), smooth=smooth)
    found = cells.at(np.array([0.1, x, 0.9]), np.array([0.1, y, 0.9]))
    assert found[1] == NO_SITE and (found[[0, 2]] >= 0).all()


@pytest.mark.parametrize("flip", ["none", "horizontal", "vertical"])
@pytest.mark.parametrize("frame", [(113, 150), (96, 128), (90, 100)])
def test_samples_on_the_border_of_a_cell_fall_to_one_side_on_both_panels(
    frame: tuple[int, int], flip: str
) -> None:
    """Where panels and camera lie exactly on each other, samples come to lie exactly on borders;
    rounding must not give one sample the mask of one cell and the light of another."""
    place = Placing(flip=flip)  # type: ignore[arg-type]
    config = Config(
        projector=PanelConfig(size_px=(1024, 768)),
        mask=PanelConfig(size_px=(1600, 1200)),
        camera=CameraConfig(place=place, frame_quads=(frame[1], frame[0])),
        scene=SceneConfig(grid=(24, 32)),
    )
    looks = CameraSamples(OpticalSetting(config, BenchTruth(), frame))
    apart = 0
    for chunk in looks.chunks():
        on_mask, on_projector = looks.on_mask(chunk), looks.on_projector(chunk, 0)
        for axis, cells in enumerate((32, 24)):
            mask = np.floor(on_mask[axis] * cells / (1600, 1200)[axis])
            lit = np.floor(on_projector[axis] * cells / (1024, 768)[axis])
            apart += int(np.sum(mask != lit))
    assert apart == 0
