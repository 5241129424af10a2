"""Calibrations on a display that misses refreshes, and with frames that are too small."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import DisplayConfig, FaultsConfig, RigConfig
from pdcd.bench.truth import load_bench_truth
from pdcd.capture.again import recompute_calibration
from pdcd.panels.map import map_between
from pdcd.panels.map_file import load_maps
from pdcd.protocol.events import ShotArmed
from tests.e2e.calibration.steps_rig import make_config
from tests.taken import calibrate_once

pytestmark = pytest.mark.whole

TRUTH = "[mask.place]\nturn_deg = 1.0\nscale = 1.04\n[camera.place]\nscale = 1.08\n"
SLOW = DisplayConfig(faults=FaultsConfig(late={str(row): 1 for row in range(5, 300, 7)}))
"""Of seven refreshes one comes late, in every exposure."""


def test_still_photos_of_a_slow_display_are_kept_where_the_rig_has_them_kept(
    tmp_path: Path,
) -> None:
    rig = RigConfig(on_miss="flag", retries=0)
    config = make_config(tmp_path, TRUTH, rig=rig, display=SLOW)
    found = calibrate_once(config, "geometry")
    assert found.result.state == "done", found.result.error
    said = "refreshes came late, and its light was divided by 1.1"
    assert any(said in text for text in found.result.warnings)
    true = panels_of(load_bench_truth(config).of(config)).mask.map
    maps = load_maps(found.folder / "maps.npz")
    x, y = np.meshgrid(np.linspace(20, 236, 9), np.linspace(20, 172, 7))
    places = np.stack([x, y], axis=-1).reshape(-1, 2)
    field = maps["projector"].to_field(places)
    apart = map_between(maps["mask"], maps["projector"], true.from_field(field)) - places
    assert np.hypot(*apart.T).max() < 0.2
    assert recompute_calibration(found.folder).identical


@pytest.mark.parametrize(
    ("on_miss", "step"), [("abort", "geometry"), ("flag", "sensor"), ("flag", "timing")]
)
def test_what_counts_refreshes_is_not(tmp_path: Path, on_miss: str, step: str) -> None:
    rig = RigConfig(on_miss=on_miss, retries=0)  # type: ignore[arg-type]
    config = make_config(tmp_path, TRUTH, rig=rig, display=SLOW, placed=True)
    error = calibrate_once(config, step).result.error
    assert error is not None
    assert error["kind"] == "sync" and "was spoilt 1 times" in str(error["message"])
    # Nobody is told to set what is set.
    better = "rig.on_miss = 'flag'" if on_miss == "abort" else "leave its step out"
    assert better in str(error["hint"])


@pytest.mark.parametrize(
    ("quads", "told"), [((16, 12), "16 x 12 pixels is too small"), ((64, 48), "too coarse for")]
)
def test_a_frame_that_is_too_small_for_a_later_step_is_told_of_before_the_first(
    tmp_path: Path, quads: tuple[int, int], told: str
) -> None:
    found = calibrate_once(make_config(tmp_path, TRUTH, quads=quads))
    error = found.result.error
    assert error is not None and told in str(error["message"]), error
    assert "camera.frame_quads" in str(error["hint"])
    assert sum(isinstance(event, ShotArmed) for event in found.heard) <= 1
