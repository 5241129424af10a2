"""The parts of a capture tell how much smooth light it holds: less error, and bars that know."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, SceneConfig
from pdcd.capture.engine import Engine
from pdcd.panels.placing import Placing
from pdcd.pictures import bars
from pdcd.pictures.decode import decode_folder
from pdcd.pictures.photos import NO_SMOOTH_MODELS
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig

GRID = (12, 16)


def take(folder: Path, goal: str, **fields: Any) -> tuple[Path, float, float]:
    """The folder, RMS error over RMS of the true picture, and sigma of the codes over error."""
    config = bench_rig.config(
        Path(tempfile.mkdtemp(dir=folder)),
        grid=GRID,
        scene=SceneConfig(kind="wax-disk", grid=GRID),
        camera=CameraConfig(noise="none", **fields.pop("camera", {})),
    )
    engine = Engine.from_config(config)
    engine.start()
    result = bench_rig.capture(
        engine, msgspec.convert({"goal": goal, "codes": 32, "parts": 4, **fields}, CaptureRequest)
    )
    engine.stop()
    assert result.error is None and result.folder is not None, result.error
    found = Path(result.folder)
    with np.load(found / "probe.npz") as made:
        sigma = made["sigma_code"]
    with np.load(found / "truth.npz") as known:
        light = float(np.sqrt(np.mean(known["image"] ** 2)))
    error = result.summary["rms_error_quads"]
    assert isinstance(error, float)
    return found, error, float(np.sqrt(np.mean(sigma**2))) / (error * light)


@pytest.mark.parametrize(
    ("goal", "fields", "most"),
    [
        ("indirect", {}, 0.7),
        ("indirect", {"camera": {"quads_per_cell": 3}}, 0.7),
        ("indirect", {"camera": {"frame_quads": (48, 36), "place": Placing(scale=0.8)}}, 0.85),
        ("long-range", {"radius": 2, "codes": 128, "pilot": 0}, 0.85),
    ],
)
def test_smooth_light_is_corrected_by_what_parts_tell(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    goal: str,
    fields: dict[str, Any],
    most: float,
) -> None:
    folder, error, ratio = take(tmp_path, goal, **fields)
    assert decode_folder(folder).identical
    assert 0.6 < ratio < 2.0, ratio
    monkeypatch.setattr(bars, "fit_smooth_models", lambda *_, **__: NO_SMOOTH_MODELS)
    before = take(tmp_path, goal, **fields)[1]
    assert error < most * before, (error, before)
    assert not decode_folder(folder).identical


def test_few_exposures_and_runs_uncorrected_are_told_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: Any, **__: Any) -> None:
        raise AssertionError("shares were looked for")

    monkeypatch.setattr("pdcd.pictures.photos._told_of", refused)
    take(tmp_path, "indirect", parts=1)
    take(tmp_path, "indirect", parts=2)
    take(tmp_path, "indirect", smooth=False)
    take(tmp_path, "split", period=4)
