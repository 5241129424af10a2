"""The correction for smooth light, through the whole chain."""

from __future__ import annotations

from pathlib import Path

from pdcd.config import CameraConfig, SceneConfig
from pdcd.decode import decode_folder
from pdcd.engine import Engine
from pdcd.request import CaptureRequest, CaptureResult
from tests import bench_rig


def run(folder: Path, request: CaptureRequest) -> CaptureResult:
    folder.mkdir()
    scene = SceneConfig(kind="milky-bottle", grid=(24, 32))
    quiet = CameraConfig(noise="none")
    engine = Engine.from_config(bench_rig.config(folder, scene=scene, camera=quiet))
    engine.start()
    return bench_rig.capture(engine, request)


def test_milk_gets_closer_to_the_truth(tmp_path: Path) -> None:
    errors = []
    for smooth in (False, True):
        request = CaptureRequest(goal="indirect", codes=32, smooth=smooth)
        result = run(tmp_path / str(smooth), request)
        assert result.folder is not None, result.error
        assert decode_folder(Path(result.folder))["identical"]
        errors.append(float(str(result.summary["rms_error"])))
    assert errors[1] < 0.8 * errors[0]


def test_goals_without_an_indirect_photo_refuse(tmp_path: Path) -> None:
    request = CaptureRequest(goal="fraction", p=0.5, codes=32, smooth=True)
    result = run(tmp_path / "run", request)
    assert result.error is not None and result.error["kind"] == "config"
