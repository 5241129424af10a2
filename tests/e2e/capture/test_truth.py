"""Captures on a bench that is not what its configuration says."""

from __future__ import annotations

from pathlib import Path

from pdcd.bench.tables import (
    BenchConfig,
    CameraConfig,
    Config,
    PanelConfig,
    SceneConfig,
    ServerConfig,
)
from pdcd.capture.engine import Engine
from pdcd.panels.placing import Placing
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig

GRID = (12, 16)
PLACE = "place = { scale = 1.2, offset_px = [7.0, 0.0] }"


def config_of(folder: Path, truth: str, mask: Placing) -> Config:
    folder.mkdir()
    path = folder / "truth.toml"
    path.write_text(truth)
    return Config(
        projector=PanelConfig(size_px=(256, 192)),
        mask=PanelConfig(size_px=(256, 192), place=mask),
        camera=CameraConfig(noise="none", frame_quads=(88, 66)),
        scene=SceneConfig(grid=GRID),
        bench=BenchConfig(truth=str(path)),
        server=ServerConfig(state_dir=str(folder / "state")),
    )


def rms_error_quads(config: Config) -> float:
    """What a capture says that its photo is off the truth."""
    engine = Engine.from_config(config)
    engine.start()
    request = CaptureRequest(goal="indirect", codes=16, window="quarter")
    result = bench_rig.capture(engine, request)
    engine.stop()
    assert result.error is None, result.error
    error = result.summary["rms_error_quads"]
    assert isinstance(error, float)
    return error


def test_the_error_against_the_truth_tells_a_wrong_belief_from_a_right_one(tmp_path: Path) -> None:
    """A mask that lies half a cell aside, and is believed to do so, or not."""
    there = Placing(scale=1.2, offset_px=(7.0, 0.0))
    right, wrong = (
        rms_error_quads(config_of(tmp_path / name, f"[mask]\n{PLACE}\n", believed))
        for name, believed in (("right", there), ("wrong", Placing(scale=1.2)))
    )
    assert right < 0.1
    assert wrong > 2.0 * right
