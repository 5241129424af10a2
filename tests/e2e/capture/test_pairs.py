"""Complement pairs and two buckets, from request to run folder."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from pdcd.bench.checks import find_cross_faults
from pdcd.bench.tables import CameraConfig, Config, PanelConfig
from pdcd.capture.engine import Engine
from pdcd.pictures.decode import decode_folder
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult, Quality
from pdcd.runs.folder import read_manifest
from tests import bench_rig
from tests.sampled import sampled

GRID = (6, 8)


def take(folder: Path, *, ambient: float = 0.0, buckets: int = 1, **fields: Any) -> CaptureResult:
    config = bench_rig.config(
        folder,
        grid=GRID,
        scene=bench_rig.matrix_scene(folder, GRID, ambient=ambient),
        camera=CameraConfig(noise="none", buckets=buckets),  # type: ignore[arg-type]
    )
    engine = Engine.from_config(config)
    engine.start()
    asked = {
        "goal": "indirect", "codes": 64, "method": "pairs", "out": tempfile.mkdtemp(dir=folder),
        **fields,
    }  # fmt: skip
    result = bench_rig.capture(engine, msgspec.convert(asked, CaptureRequest))
    engine.stop()
    assert result.error is None and result.folder is not None, result.error
    return result


def picture(result: CaptureResult, name: str) -> np.ndarray:
    found = cv2.imread(f"{result.folder}/linear/{name}.tif", cv2.IMREAD_UNCHANGED)
    assert found is not None
    return np.asarray(found[..., 1]).ravel()


def check_pictures(result: CaptureResult) -> None:
    """Against the transport itself; rounding of a mock sensor is all that is left."""
    transport = bench_rig.transport(GRID)
    direct, whole = np.diag(transport), transport.sum(axis=1)
    wanted = {"direct": direct, "indirect": whole - direct, "white": whole}
    for name, truth in wanted.items():
        error = picture(result, name) - truth
        assert np.sqrt(np.mean(error**2)) < 5e-3 * np.sqrt(np.mean(truth**2)), name


@pytest.mark.parametrize("buckets", sampled([2, 1], 2))
def test_direct_indirect_and_white_of_one_pair(buckets: int, tmp_path: Path) -> None:
    result = take(tmp_path, buckets=buckets, black_level="none")
    check_pictures(result)
    assert decode_folder(Path(str(result.folder))).identical
    quality = result.summary["quality"]
    assert isinstance(quality, Quality) and not any("add up" in r for r in quality.reasons)
    shots = read_manifest(Path(str(result.folder))).run.shots
    assert [shot.name for shot in shots] == ["white", "coded", "same"]
    assert len({shot.open_ns for shot in shots}) == 4 - buckets  # exposures


def test_two_buckets_take_half_the_time(tmp_path: Path) -> None:
    pair = take(tmp_path, white=False, black_level="none")
    both = take(tmp_path, white=False, black_level="none", buckets=2)
    times_s = [result.summary["exposure_s"] for result in (pair, both)]
    assert isinstance(times_s[0], float) and isinstance(times_s[1], float)
    assert times_s[0] == pytest.approx(2.0 * times_s[1], rel=1e-9)


def test_a_pair_that_does_not_add_up_says_so(tmp_path: Path) -> None:
    """Ambient light counts twice in the sum, and once in the floodlit photo."""
    quality = take(tmp_path, ambient=0.3, black_level="none").summary["quality"]
    assert isinstance(quality, Quality)
    assert any("does not add up to the white photo" in reason for reason in quality.reasons)


@pytest.mark.parametrize("buckets", sampled([1, 2], 2))
def test_black_exposures_and_parts_of_pairs(buckets: int, tmp_path: Path) -> None:
    result = take(tmp_path, ambient=0.1, buckets=buckets, parts=4, codes=256)
    assert read_manifest(Path(str(result.folder))).run.how.black_level == "ambient"
    check_pictures(result)


def test_a_sensor_that_is_its_own_mask_switches_at_once() -> None:
    slow = Config(camera=CameraConfig(buckets=2), mask=PanelConfig(size_px=(8, 8), rise_s=0.001))
    assert any("camera.buckets" in fault.keys for fault in find_cross_faults(slow))


@pytest.mark.parametrize("buckets", [1, 2])
@pytest.mark.parametrize(("until", "parts"), [(0.9, 4), (1e-6, 5)])
def test_pairs_in_parts_end_when_they_are_good_enough(
    buckets: int, until: float, parts: int, tmp_path: Path
) -> None:
    result = take(tmp_path, buckets=buckets, codes=40, parts=5, until_error=until)
    assert result.state == "done" and result.summary["parts"] == parts
    short = [text for text in result.warnings if text.startswith("sigma came down to")]
    assert len(short) == (until < 0.5)
