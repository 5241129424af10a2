"""Complement pairs and two buckets, from request to run folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.checks import find_cross_faults
from pdcd.bench.tables import CameraConfig, Config, PanelConfig
from tests import bench_rig, taken
from tests.taken import Taken, relative_rms

pytestmark = pytest.mark.whole

GRID = (6, 8)


def take(folder: Path, *, ambient: float = 0.0, buckets: int = 1, **fields: Any) -> Taken:
    config = bench_rig.config(
        folder,
        grid=GRID,
        scene=bench_rig.matrix_scene(folder, GRID, ambient=ambient),
        camera=CameraConfig(noise="none", buckets=buckets),  # type: ignore[arg-type]
    )
    return taken.take(config, **{"codes": 64, "method": "pairs", **fields})


def check_pictures(made: Taken) -> None:
    """Against the transport itself; rounding of a mock sensor is all that is left."""
    transport = bench_rig.transport(GRID)
    direct, whole = np.diag(transport), transport.sum(axis=1)
    for name, truth in {"direct": direct, "indirect": whole - direct, "white": whole}.items():
        assert relative_rms(made.picture(name)[..., 1].ravel(), truth) < 5e-3, name


@pytest.mark.whole
def test_direct_indirect_and_white_of_one_pair_and_two_buckets_take_half_the_time(
    tmp_path: Path,
) -> None:
    times_s = {}
    for buckets in (1, 2):
        out = str(tmp_path / str(buckets))
        made = take(tmp_path, buckets=buckets, black_level="none", out=out)
        check_pictures(made)
        assert made.decodes_the_same()
        assert not any("add up" in reason for reason in made.quality.reasons)
        shots = made.manifest.run.shots
        assert [shot.name for shot in shots] == ["white", "coded", "same"]
        assert len({shot.open_ns for shot in shots}) == 4 - buckets  # exposures
        bare = take(tmp_path, buckets=buckets, black_level="none", white=False, out=f"{out}-bare")
        times_s[buckets] = bare.summary["exposure_s"]
    assert times_s[1] == pytest.approx(2.0 * times_s[2], rel=1e-9)


def test_a_pair_that_does_not_add_up_says_so(tmp_path: Path) -> None:
    """Ambient light counts twice in the sum, and once in the floodlit photo."""
    quality = take(tmp_path, ambient=0.3, black_level="none").quality
    assert any("does not add up to the white photo" in reason for reason in quality.reasons)


def test_black_exposures_and_parts_of_pairs(tmp_path: Path) -> None:
    made = take(tmp_path, ambient=0.1, parts=4, codes=256)
    assert made.manifest.run.how.black_level == "ambient"
    check_pictures(made)


def test_a_sensor_that_is_its_own_mask_switches_at_once() -> None:
    slow = Config(camera=CameraConfig(buckets=2), mask=PanelConfig(size_px=(8, 8), rise_s=0.001))
    assert any("camera.buckets" in fault.keys for fault in find_cross_faults(slow))


@pytest.mark.parametrize(("buckets", "until", "parts"), [(1, 0.9, 4), (2, 1e-6, 5)])
def test_pairs_in_parts_end_when_they_are_good_enough(
    buckets: int, until: float, parts: int, tmp_path: Path
) -> None:
    made = take(tmp_path, buckets=buckets, codes=40, parts=5, until_error=until)
    assert made.summary["parts"] == parts
    short = [text for text in made.warnings if text.startswith("sigma came down to")]
    assert len(short) == (until < 0.5)
