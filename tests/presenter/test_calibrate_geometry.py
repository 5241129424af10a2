"""`calibrate geometry` with real windows and an EOS body, without knowing where things lie."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.calibration import read_calibration
from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.bench.tables import BenchConfig, CameraConfig, RigConfig, SceneConfig, TriggerConfig
from pdcd.bench.truth import load_bench_truth
from pdcd.calibration.light import metering
from pdcd.capture.again import recompute_calibration
from pdcd.capture.engine import Engine
from pdcd.panels.map import map_between
from pdcd.panels.map_file import load_maps
from pdcd.protocol.request import CalibrateRequest
from tests import x11_rig
from tests.xserver import XServer

TRUTH = """
[mask]
contrast = 300.0
[mask.place]
turn_deg = 0.9
scale = 1.05
offset_px = [1.7, -1.2]
[camera.place]
turn_deg = -2.0
scale = 1.1
offset_px = [3.0, -2.0]
"""
FRAME = (420, 280)
NEAR_PX = 0.1


@pytest.mark.long
@pytest.mark.timeout(180)
def test_maps_are_found_through_real_windows(
    tmp_path: Path, x_quarter: XServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metering, "WISHED", metering.LEAST)  # photos of a second each
    (tmp_path / "truth.toml").write_text(TRUTH)
    config = x11_rig.config(
        tmp_path,
        x_quarter,
        rig=RigConfig(clock="real", settle_s=0.05, retries=20),
        camera=CameraConfig(
            driver="ptp", profile="450d", frame_quads=FRAME, options={"usb": "virtual"}
        ),
        trigger=TriggerConfig(driver="ptp"),
        scene=SceneConfig(kind="card", grid=(12, 16)),
        bench=BenchConfig(truth=str(tmp_path / "truth.toml")),
    )
    engine = Engine.from_config(config)
    heard: list[str] = []
    try:
        engine.start()
        result = engine.calibrate(
            CalibrateRequest(steps=("geometry",)),
            job="one",
            emit=lambda event: heard.append(event.type),
            cancelled=lambda: False,
        )
        assert result.state == "done", result.error
        true = load_bench_truth(config).of(config)
        panels, camera = panels_of(true), make_camera_map(true, FRAME[::-1])
        maps = load_maps(Path(str(result.folder)) / "maps.npz")
        width, height = config.projector.size_px
        x, y = np.meshgrid(
            np.linspace(0.08, 0.92, 15) * width, np.linspace(0.08, 0.92, 12) * height
        )
        places = np.stack([x, y], axis=-1).reshape(-1, 2)
        field = panels.projector.map.to_field(places)
        for name, map_ in (("mask", panels.mask.map), ("camera", camera)):
            found = map_between(maps[name], maps["projector"], map_.from_field(field))
            assert np.percentile(np.hypot(*(found - places).T), 95.0) < NEAR_PX, name
        # From now on it is in use.
        assert engine._config.mask.place.map == maps["mask"]
        record, digest = read_calibration(Path(str(result.folder)))
        assert engine._config.calibration.sha256 == digest == result.manifest_sha256
        assert "EOS" in record.identity.camera_model
        assert all(photo.source == "present-msc" for s in record.steps for photo in s.photos)
    finally:
        engine.stop()
    assert heard.count("shutter_open") == heard.count("shutter_closed") >= 7
    report = recompute_calibration(Path(str(result.folder)))
    assert report.identical, report
