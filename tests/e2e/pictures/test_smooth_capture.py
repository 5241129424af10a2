"""The correction for smooth light, through the whole chain."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.bench.tables import CameraConfig, SceneConfig
from pdcd.capture.engine import Engine
from pdcd.pictures.decode import decode_folder
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from tests import bench_rig


def run(folder: Path, request: CaptureRequest, kind: str = "milky-bottle") -> CaptureResult:
    folder.mkdir()
    scene = SceneConfig(kind=kind, grid=(24, 32))
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
        assert decode_folder(Path(result.folder)).identical
        errors.append(float(str(result.summary["rms_error_quads"])))
    assert errors[1] < 0.8 * errors[0]


@pytest.mark.long
def test_what_quarter_windows_miss_beside_each_cell_is_not_taken_for_an_error_of_codes(
    tmp_path: Path,
) -> None:
    for kind in ("milky-bottle", "open-book"):
        errors = []
        for smooth in (False, True):
            request = CaptureRequest(goal="indirect", codes=128, window="quarter", smooth=smooth)
            result = run(tmp_path / f"{kind}-{smooth}", request, kind)
            errors.append(float(str(result.summary["rms_error_quads"])))
        assert errors[1] < 1.01 * errors[0]


def test_it_is_on_with_hadamard_codes_and_off_with_others_unless_told(tmp_path: Path) -> None:
    found = {}
    for name, fields in {
        "default": {},
        "on": {"smooth": True},
        "off": {"smooth": False},
        "balanced": {"family": "balanced"},
        "balanced on": {"family": "balanced", "smooth": True},
    }.items():
        request = CaptureRequest(goal="indirect", codes=32, **fields)  # type: ignore[arg-type]
        found[name] = float(str(run(tmp_path / name, request).summary["rms_error_quads"]))
    assert found["default"] == found["on"] < 0.9 * found["off"]
    assert found["balanced on"] < 0.7 * found["balanced"]


def test_lost_codes_and_weights_of_each_cell_are_known_to_it(tmp_path: Path) -> None:
    rows = CaptureRequest(goal="indirect", codes=32, normalise="row")
    plain = CaptureRequest(goal="indirect", codes=32, normalise="row", smooth=False)
    better, worse = (
        float(str(run(tmp_path / name, request).summary["rms_error_quads"]))
        for name, request in (("better", rows), ("worse", plain))
    )
    assert better < 0.9 * worse


def test_goals_without_an_indirect_photo_refuse(tmp_path: Path) -> None:
    request = CaptureRequest(goal="fraction", p=0.5, codes=32, smooth=True)
    result = run(tmp_path / "run", request)
    assert result.error is not None and result.error["kind"] == "request"
