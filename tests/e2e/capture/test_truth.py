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
from pdcd.panels.placing import Placing
from tests.taken import take

TRUE = "[mask]\nplace = { scale = 1.2, offset_px = [7.0, 0.0] }\n"
"""Half a cell aside."""


def error(folder: Path, believed: Placing) -> float:
    """What a capture says that its photo is off the truth."""
    folder.mkdir()
    path = folder / "truth.toml"
    path.write_text(TRUE)
    small = (128, 96)
    config = Config(
        projector=PanelConfig(size_px=small),
        mask=PanelConfig(size_px=small, place=believed),
        camera=CameraConfig(noise="none", frame_quads=(44, 33)),
        scene=SceneConfig(grid=(6, 8)),
        bench=BenchConfig(truth=str(path)),
        server=ServerConfig(state_dir=str(folder / "state")),
    )
    return take(config, codes=16, window="quarter").error


def test_the_error_against_the_truth_tells_a_wrong_belief_from_a_right_one(tmp_path: Path) -> None:
    right = error(tmp_path / "right", Placing(scale=1.2, offset_px=(7.0, 0.0)))
    wrong = error(tmp_path / "wrong", Placing(scale=1.2))
    assert right < 0.1
    assert wrong > 2.0 * right
