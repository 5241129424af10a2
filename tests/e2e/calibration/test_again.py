"""A calibration that followed another one is computed again from its photos, too."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.capture.again import recompute_calibration
from tests.e2e.calibration.steps_rig import SmallBench
from tests.taken import Calibrated, calibrate_once

pytestmark = pytest.mark.whole

TRUTH = """
[mask]
contrast = 300.0
[mask.place]
turn_deg = 0.7
offset_px = [{right_px}, -0.7]
[camera]
blur_quads = 0.5
[camera.place]
turn_deg = -1.4
offset_px = [2.0, 1.0]
scale = 1.06
"""


def ran(
    folder: Path, *steps: Any, seed: int, right_px: float = 1.3, after: Calibrated | None = None
) -> Calibrated:
    """The same bench another time, by the calibration before, or a mask that was bumped."""
    use = "latest" if after is None else str(after.folder)
    config = SmallBench(folder, TRUTH.format(right_px=right_px), quads=(300, 216), use=use).config
    camera = msgspec.structs.replace(config.camera, seed=seed)
    return calibrate_once(msgspec.structs.replace(config, camera=camera), *steps)


def differing(folder: Path) -> list[str]:
    return [item.name for item in recompute_calibration(folder).items if not item.identical]


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Calibrated]:
    """A bench that was calibrated twice, each time with a first look for checks."""
    folder = tmp_path_factory.mktemp("twice") / "bench"
    first = ran(folder, "geometry", "check", seed=5)
    assert differing(first.folder) == []
    return folder, ran(folder, "geometry", "check", seed=6, after=first)


def test_a_first_look_after_another_calibration(twice: tuple[Path, Calibrated]) -> None:
    assert twice[1].record.before is not None
    assert differing(twice[1].folder) == []


def test_the_same_without_the_calibration_before(
    twice: tuple[Path, Calibrated], tmp_path: Path
) -> None:
    alone = tmp_path / "away" / "alone"
    shutil.copytree(twice[1].folder, alone)
    assert differing(alone) == []


def test_a_check_that_took_a_change_into_account(twice: tuple[Path, Calibrated]) -> None:
    changed = ran(twice[0], "check", seed=7, right_px=1.5, after=twice[1])
    assert "mask.place.map" in changed.record.measured and changed.record.verdict == "doubtful"
    assert changed.record.measured["mask.place.map"].step == "check"
    assert differing(changed.folder) == []
