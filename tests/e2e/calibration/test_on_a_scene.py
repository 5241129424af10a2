"""`calibrate geometry` on the scene itself: nobody puts up a card."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.calibration import MAPS
from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.bench.truth import load_bench_truth
from pdcd.capture.again import recompute_calibration
from pdcd.panels.map import map_between
from pdcd.panels.map_file import load_maps
from tests.e2e.calibration.steps_rig import SmallBench
from tests.taken import Calibrated, calibrate, started

pytestmark = pytest.mark.whole

TRUTH = """
[mask.place]
turn_deg = 1.0
scale = 1.04
offset_px = [1.0, -2.0]
[camera.place]
scale = 1.08
turn_deg = {turn}
"""
QUADS = (384, 256)


def bench(folder: Path, turn_deg: float = 0.0, use: str = "latest") -> SmallBench:
    truth = TRUTH.format(turn=turn_deg)
    return SmallBench(folder, truth, scene="open-book", quads=QUADS, use=use)


def off_px(found: Calibrated, made: SmallBench) -> float:
    """95th percentile of how far the camera's map to the projector lies from the truth."""
    maps = load_maps(found.folder / MAPS)
    true = load_bench_truth(made.config).of(made.config)
    x, y = np.meshgrid(np.linspace(48, 336, 19), np.linspace(32, 224, 13))
    quads = np.stack([x, y], axis=-1).reshape(-1, 2)
    said = map_between(maps["camera"], maps["projector"], quads)
    real = map_between(make_camera_map(true, QUADS[::-1]), panels_of(true).projector.map, quads)
    return float(np.percentile(np.hypot(*(said - real).T), 95.0))


@pytest.mark.timeout(300)
def test_a_bumped_camera_is_found_on_the_scene_and_computed_again(tmp_path: Path) -> None:
    made = bench(tmp_path)
    with started(made.config) as engine:
        before = calibrate(engine, "geometry")
        assert off_px(before, made) < 0.1
        assert engine._rig.scene is not None and engine._rig.scene.name == "open-book"
    bumped = bench(tmp_path, turn_deg=1.5, use=str(before.folder))
    found = bumped.calibrate("geometry", subject="scene")
    record = found.record
    names = [photo.name for photo in found.step("geometry").photos]
    assert len(names) == 3 + 9 and "geometry-blocks-projector" in names
    assert (record.subject, record.marks) == ("scene", "auto")
    assert off_px(before, bumped) > 2.0
    assert off_px(found, bumped) < 0.1
    assert recompute_calibration(found.folder).identical
