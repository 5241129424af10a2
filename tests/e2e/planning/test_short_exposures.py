"""What is foreseen of two DMDs, whose exposures are too short to fill the sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.bench.tables import (
    CameraConfig,
    DisplayConfig,
    PanelConfig,
    RigConfig,
    SceneConfig,
    ScheduleConfig,
)
from tests import bench_rig
from tests.taken import take

GRID = (24, 32)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("scene", "row_us", "late_us", "guards"),
    [
        ("open-book", 105, 0, "none"),
        ("open-book", 105, 10, "auto"),
        ("wax-disk", 105, 2, "dark"),
        ("wax-disk", 1000, 10, "both"),
        ("open-book", 16667, 0, "full"),
    ],
)
def test_the_error_of_two_dmds_is_foreseen_to_a_quarter(
    scene: str, row_us: int, late_us: int, guards: Any, tmp_path: Path
) -> None:
    panel = PanelConfig((192, 144), refresh_hz=1e6 / row_us)
    config = bench_rig.config(
        tmp_path,
        grid=GRID,
        scene=SceneConfig(kind=scene, grid=GRID),
        camera=CameraConfig(noise="full"),
        projector=panel,
        mask=msgspec.structs.replace(panel, skew_s=1e-6 * late_us),
        display=DisplayConfig(row_times=True),
        rig=RigConfig(settle_s=0.002),
        schedule=ScheduleConfig(guards=guards),
    )
    summary = take(config, error=0.03, black_level="none").summary
    assert summary["predicted_error"] == pytest.approx(summary["rms_error_cells"], rel=0.25)
    assert summary["rms_error_cells"] < 0.03
