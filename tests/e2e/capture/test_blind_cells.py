"""Cells without a pixel are blind, and captures run; what cannot be shown is refused before any
light."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import (
    CalibrationConfig,
    CameraConfig,
    Config,
    PanelConfig,
    SceneConfig,
    ServerConfig,
)
from pdcd.panels.placing import Placing
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from tests.taken import request_of, started

GRID = (12, 16)


def bench(folder: Path, **mask: Any) -> Config:
    return Config(
        projector=PanelConfig(size_px=(128, 96)),
        mask=PanelConfig(size_px=(256, 192), **mask),
        camera=CameraConfig(frame_quads=(128, 96), noise="none"),
        scene=SceneConfig(kind="open-book", grid=GRID),
        calibration=CalibrationConfig(use="none"),
        server=ServerConfig(state_dir=str(folder / "state")),
    )


def capture(config: Config) -> tuple[CaptureResult, list[object]]:
    events: list[object] = []
    asked = request_of(codes=32, parts=1)
    with started(config) as engine:
        result = engine.capture(asked, job="job", emit=events.append, cancelled=lambda: False)
    return result, events


@pytest.mark.whole
def test_a_mask_that_leaves_a_column_of_cells_without_pixels(tmp_path: Path) -> None:
    """12 px to the right are a column of cells and a half."""
    result, _ = capture(bench(tmp_path, place=Placing(offset_px=(12.0, 0.0))))
    assert result.state == "done", result.error
    assert result.summary["blind_share"] == 1 / 16
    assert any("6.2 % of the cells are blind" in text for text in result.warnings)
    folder = Path(str(result.folder))
    with np.load(folder / "probe.npz") as probe:
        image, sigma = probe["image"], probe["sigma"]
    assert np.isinf(sigma[:, 0]).all() and (image[:, 0] == 0.0).all()
    assert np.isfinite(sigma[:, 2:]).all()
    reasons = read_manifest(folder).plan["reasons"]
    assert any("of the cells have no pixel on the mask" in text for text in reasons)
    # What is known is right: the light that the blind cells do not send is missing in truth, too.
    assert float(result.summary["rms_error_quads"]) < 0.05  # type: ignore[arg-type]


def test_cells_that_no_panel_can_show_are_refused_before_any_light(tmp_path: Path) -> None:
    coarse = bench(tmp_path)
    coarse = msgspec.structs.replace(coarse, mask=PanelConfig(size_px=(12, 9)))
    result, events = capture(coarse)
    assert result.state == "failed" and result.error is not None
    assert "have no pixel on the mask" in str(result.error["message"])
    assert not any("exposure" in type(event).__name__.lower() for event in events)
