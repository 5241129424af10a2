"""Panels that cover parts of each other, and cameras that see a part of the field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.calibration import MAPS
from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.bench.tables import PanelConfig
from pdcd.bench.truth import load_bench_truth
from pdcd.panels.map import map_between
from pdcd.panels.map_file import load_maps
from tests.e2e.calibration.steps_rig import SmallBench
from tests.taken import Calibrated, calibrate, started

pytestmark = pytest.mark.whole

TRUTH = """
[projector]
contrast = 900.0
rise_s = 0.002
fall_s = 0.0015
[mask]
contrast = 350.0
skew_s = 0.004
rise_s = 0.004
fall_s = 0.003
[mask.place]
scale = {mask}
[camera.place]
scale = {camera}
"""
QUADS = (360, 240)
STEPS = ("sensor", "light", "geometry", "timing", "shutter", "registration", "check")


def bench(folder: Path, mask: float, camera: float) -> SmallBench:
    return SmallBench(folder, TRUTH.format(mask=mask, camera=camera), quads=QUADS)


def off_px(found: Calibrated, made: SmallBench) -> float:
    """95th percentile over what the camera sees through the mask."""
    maps, true = load_maps(found.folder / MAPS), load_bench_truth(made.config).of(made.config)
    panels = panels_of(true)
    x, y = np.meshgrid(np.arange(4.0, QUADS[0], 8.0), np.arange(4.0, QUADS[1], 8.0))
    quads = np.stack([x, y], axis=-1).reshape(-1, 2)
    camera = make_camera_map(true, QUADS[::-1])
    on_mask = map_between(camera, panels.mask.map, quads)
    seen = ((on_mask > 0.0) & (on_mask < panels.mask.map.size_px)).all(axis=-1)
    real = map_between(camera, panels.projector.map, quads)
    seen &= ((real > 0.0) & (real < panels.projector.map.size_px)).all(axis=-1)
    said = map_between(maps["camera"], maps["projector"], quads)
    return float(np.percentile(np.hypot(*(said - real)[seen].T), 95.0))


@pytest.mark.timeout(300)
@pytest.mark.long
@pytest.mark.parametrize(
    ("mask", "camera", "steps"),
    [
        (0.8, 0.9, ("light", "geometry", "timing", "registration")),
        (0.75, 1.05, STEPS),
    ],
)
def test_a_mask_that_covers_a_part_of_the_field(
    tmp_path: Path, mask: float, camera: float, steps: tuple[str, ...]
) -> None:
    made = bench(tmp_path, mask, camera)
    found = made.calibrate(*steps)
    assert found.record.verdict != "bad"
    values = {key: entry.value for key, entry in found.record.measured.items()}
    for key, true, share in (
        ("projector.contrast", 900.0, 0.05), ("mask.contrast", 350.0, 0.05),
        ("projector.rise_s", 0.002, 0.06), ("projector.fall_s", 0.0015, 0.06),
        ("mask.rise_s", 0.004, 0.06), ("mask.fall_s", 0.003, 0.06),
    ):  # fmt: skip
        assert values[key] == pytest.approx(true, rel=share), key
    assert values["mask.skew_s"] == pytest.approx(0.004, abs=0.00015)
    assert off_px(found, made) < 0.3


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_mask_of_half_as_many_pixels_as_the_projector(tmp_path: Path) -> None:
    """Stripes of 6 px would be three of its pixels: wider ones tell the same."""

    text = TRUTH.format(mask=1.04, camera=1.05) + "[scene]\nblur_px = 1.0\n"
    panels = {
        name: PanelConfig(size_px=size)
        for name, size in (("projector", (384, 288)), ("mask", (192, 144)))
    }
    made = SmallBench(tmp_path, text, quads=(480, 360), tables=panels)
    found = made.calibrate("geometry", "registration")
    names = {photo.name for photo in found.step("registration").photos}
    assert "registration-right-10-0" in names and "registration-right-6-0" not in names
    assert found.step("registration").verdict != "bad"
    blur_px = found.record.measured["mask.blur_px"].value
    assert blur_px == pytest.approx(1.0, rel=0.1)


@pytest.mark.timeout(300)
def test_a_camera_that_sees_a_part_is_told_of_stripes(tmp_path: Path) -> None:
    made = bench(tmp_path, 1.05, 0.8)
    with started(made.config) as engine:
        dots = calibrate(engine, "geometry")
        stripes = calibrate(engine, "geometry", marks="xor")
    assert dots.record.verdict != "good" and "--marks xor" in dots.step("geometry").advice[0]
    assert stripes.record.verdict == "good"
    assert off_px(stripes, made) < 0.03
