"""Rigs of which one part is real and another is not: what they are compared with, and what said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, TriggerConfig
from pdcd.capture.engine import Engine
from pdcd.protocol.events import Event, ShutterClosed
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from tests import bench_rig
from tests.placed_film import Shot, dng

REQUEST = {"goal": "indirect", "codes": 8}


def photo(number: int) -> bytes:
    """Of something that is not the mock scene."""
    rng = np.random.default_rng(number)
    samples = rng.integers(3000, 4000, (6, 8)).astype(np.uint16)
    return dng(Shot(samples, 512, 16383, iso=100, f_number=8.0, exposure_s=1.0))


def take(folder: Path, **camera: Any) -> tuple[CaptureResult, Engine]:
    tether = folder / "tether"
    tether.mkdir()
    told = {"noise": "none", "f_number": 8.0, **camera}
    shutter = "ptp" if camera.get("driver") == "ptp" else "mock"
    trigger = TriggerConfig(driver=shutter)
    config = bench_rig.config(folder, camera=CameraConfig(**told), trigger=trigger)
    engine = Engine.from_config(config)
    closed: list[str] = []

    def emit(event: Event) -> None:
        """What a second program does: a file comes when the shutter has closed."""
        if isinstance(event, ShutterClosed):
            closed.append(event.shot)
            (tether / f"IMG_{len(closed):04d}.dng").write_bytes(photo(len(closed)))

    engine.start()
    request = msgspec.convert(REQUEST, CaptureRequest)
    result = engine.capture(request, job="job", emit=emit, cancelled=lambda: False)
    engine.stop()
    return result, engine


def test_a_real_camera_is_not_compared_with_a_scene_that_it_does_not_see(tmp_path: Path) -> None:
    options = {"folder": str(tmp_path / "tether"), "poll_s": 0.01, "looks": 2}
    result, engine = take(tmp_path, driver="folder", options=options)
    assert result.error is None and result.folder is not None
    assert result.summary["rms_error_quads"] is None
    manifest = read_manifest(Path(result.folder))
    assert not manifest.mock and manifest.drivers["mock"] is False
    assert manifest.drivers["scene"] is None
    (said,) = [text for text in manifest.warnings if "not compared with the mock scene" in text]
    assert said.startswith("display and shutter are virtual (driver mock) and the camera is not")
    assert engine.grid == bench_rig.GRID  # of the mock's scene: its panels show that many cells


@pytest.mark.parametrize("camera", [{}, {"driver": "ptp", "options": {"usb": "virtual"}}])
def test_a_camera_of_the_mock_scene_is_compared_with_it(
    tmp_path: Path, camera: dict[str, Any]
) -> None:
    """Also a virtual body, before mock panels and behind its own shutter."""
    result, _ = take(tmp_path, **camera)
    assert result.folder is not None
    assert isinstance(result.summary["rms_error_quads"], float)
    manifest = read_manifest(Path(result.folder))
    assert manifest.mock and not any("virtual (driver mock)" in w for w in manifest.warnings)
