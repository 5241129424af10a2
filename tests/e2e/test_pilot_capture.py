"""A capture guided by a pilot, through the whole chain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.archive import read_manifest
from pdcd.config import CameraConfig, SceneConfig
from pdcd.decode import decode_folder
from pdcd.engine import Engine
from pdcd.request import CaptureRequest, CaptureResult
from tests import bench_rig

MIRROR = SceneConfig(kind="matrix", path=str(bench_rig.DATA / "mirror_32x24.npz"))


def run(folder: Path, request: CaptureRequest, camera: CameraConfig | None = None) -> CaptureResult:
    quiet = CameraConfig(noise="none")
    config = bench_rig.config(folder, scene=MIRROR, camera=camera or quiet)
    engine = Engine.from_config(config)
    engine.start()
    return bench_rig.capture(engine, request)


@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_a_pilot_makes_mirrors_sharp(tmp_path: Path, window: str) -> None:
    """The same 128 codes with and without a pilot; the pilot's are counted."""
    errors = []
    for pilot in (0, 64):
        folder = tmp_path / str(pilot)
        folder.mkdir()
        request = CaptureRequest(
            goal="indirect", codes=128, pilot=pilot, white=False, window=window  # type: ignore[arg-type]
        )  # fmt: skip
        result = run(folder, request)
        assert result.state == "done", result.error
        errors.append(float(str(result.summary["rms_error"])))
    if window == "whole":
        assert errors[1] < errors[0] / 2.0
    else:
        assert errors[1] < errors[0]
    assert result.folder is not None
    done = Path(result.folder)
    assert len(list((done / "raw").glob("pilot-*.dng"))) == 64
    assert decode_folder(done)["identical"]
    assert read_manifest(done).plan["raw_files"] == 65


def test_noise_in_the_pilot_does_no_harm(tmp_path: Path) -> None:
    request = CaptureRequest(goal="indirect", codes=128, pilot=64, white=False)
    noisy = CameraConfig(noise="full")
    with_pilot = run(tmp_path, request, camera=noisy)
    other = tmp_path / "other"
    other.mkdir()
    plain = run(other, CaptureRequest(goal="indirect", codes=128, white=False), camera=noisy)
    error, base = (float(str(r.summary["rms_error"])) for r in (with_pilot, plain))
    assert error < base * 1.1


def test_plan_says_what_a_pilot_costs(tmp_path: Path) -> None:
    engine = Engine.from_config(bench_rig.config(tmp_path, scene=MIRROR))
    summary = engine.plan(CaptureRequest(goal="indirect", codes=128, pilot=64))
    pilot = next(s for s in summary.shots if s.name.startswith("pilot"))
    assert (pilot.exposures, summary.raw_files, summary.codes) == (64, 66, 128)
    total = sum(s.exposure_s * s.exposures for s in summary.shots)
    assert summary.seconds == pytest.approx(total)


@pytest.mark.parametrize(
    ("request_", "what"),
    [
        (CaptureRequest(goal="white", codes=128, pilot=64), "takes no pilot"),
        (CaptureRequest(goal="indirect", codes=64, pilot=64), "leaves none"),
        (CaptureRequest(goal="indirect", codes=128, pilot=10), "pilot"),
        (CaptureRequest(goal="indirect", codes=130, pilot=64), "66"),
        (CaptureRequest(goal="indirect", codes=128, pilot=64, family="balanced"), "cannot guide"),
    ],
)
def test_refusals(request_: CaptureRequest, what: str, tmp_path: Path) -> None:
    result = run(tmp_path, request_)
    assert result.error is not None and result.error["kind"] == "config"
    assert what in f"{result.error['message']} {result.error['hint']}"
    assert not np.any([p.suffix == ".dng" for p in tmp_path.rglob("*")])
