"""Direct light that gets into a photo of indirect light, in whole captures."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

import pdcd
from pdcd.bench.tables import CameraConfig, Config, LimitsConfig, PanelConfig, SceneConfig
from pdcd.pictures.darkroom import Darkroom
from pdcd.request import CaptureRequest
from pdcd.runs.folder import read_manifest
from tests.bench.captures import capture_with, opened


def test_direct_light_that_slow_panels_let_through_is_taken_out(tmp_path: Path) -> None:
    """Panels of milliseconds, known: what of the direct light gets into the photo is known, too.
    Runs from before that was done are decoded as they were."""
    config = Config(
        projector=PanelConfig(size_px=(256, 192), rise_s=3e-3, fall_s=3e-3, contrast=800.0),
        mask=PanelConfig(size_px=(400, 300), rise_s=4e-3, fall_s=6e-3, skew_s=4e-3, contrast=300.0),
        scene=SceneConfig(grid=(12, 16)),
        camera=CameraConfig(frame_quads=(80, 60), noise="none"),
        limits=LimitsConfig(min_free_bytes=0),
    )
    request = CaptureRequest(goal="indirect", codes=64, window="quarter", black_level="none")
    with opened(config) as engine:
        result = capture_with(engine, request, tmp_path, "job")
    assert result.folder is not None
    folder = Path(result.folder)
    truth = pdcd.open(folder).truth
    record = read_manifest(folder).run
    assert truth is not None and record.unmixed
    before = msgspec.structs.replace(record, unmixed=False)
    errors = []
    for one in (before, record):
        image = Darkroom(folder, one).decoded().cell_means.image
        errors.append(float(np.sqrt(np.mean((image - truth) ** 2) / np.mean(truth**2))))
    assert errors[0] > 0.3
    assert errors[1] < 0.02
