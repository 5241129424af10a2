"""Two DMDs whose pulses the camera counts: times are proven by what came, and by nothing else."""

from __future__ import annotations

import pytest

pytest.importorskip("drivers.virtual_genicam.bench", reason="Aravis IS MISSING (libaravis-0.8-0)")

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pdcd.bench.tables import CameraConfig, PanelConfig, RigConfig, TriggerConfig
from pdcd.errors import ConfigError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.verify import read_whole_manifest
from tests import bench_rig
from tests.dlpc900_pair import LEAST_US, make_dmds
from tests.genicam_rig import needs_aravis, turn
from tests.taken import capture_on

pytestmark = needs_aravis
WIRED, PULSES = 0, ("Line2", "Line3")
"""The value of the bit that the virtual devices pulse for, and where their outputs lead."""


@pytest.fixture(autouse=True)
def _alone() -> Iterator[None]:
    with turn():
        yield


def capture(folder: Path, trigger_bit: int, **options: Any) -> CaptureResult:
    panel = PanelConfig(size_px=(96, 64), refresh_hz=1e6 / LEAST_US)
    config = bench_rig.config(
        folder,
        grid=(6, 8),
        display=make_dmds(trigger_bit=trigger_bit),
        projector=panel,
        mask=panel,
        camera=CameraConfig(
            driver="virtual-genicam", noise="none", f_number=8.0, profile="modern", options=options
        ),
        trigger=TriggerConfig(driver="virtual-genicam", lag_s=0.001, jitter_s=0.0),
        rig=RigConfig(retries=1),
    )
    return capture_on(config, CaptureRequest(goal="indirect", codes=16))


def verified(result: CaptureResult) -> set[bool]:
    assert result.state == "done", result.error
    assert result.folder is not None
    return {shot.verified for shot in read_whole_manifest(Path(result.folder)).run.shots}


def test_times_are_proven_where_every_pulse_came(tmp_path: Path) -> None:
    result = capture(tmp_path, WIRED, pulses=PULSES)
    assert verified(result) == {True}
    assert not any("presentation times" in said for said in result.warnings)


def test_they_are_not_where_nobody_counts(tmp_path: Path) -> None:
    assert verified(capture(tmp_path, WIRED)) == {False}


@pytest.mark.parametrize(("bit", "lines"), [(1 - WIRED, PULSES), (WIRED, ("Line2", "Line2"))])
def test_photos_are_refused_whose_pulses_are_others(
    bit: int, lines: tuple[str, str], tmp_path: Path
) -> None:
    result = capture(tmp_path, bit, pulses=lines)
    assert result.state == "failed" and result.error is not None
    said = str(result.error)
    assert "TRIG_OUT_2" in said and "camera.options.pulses" in said  # both drivers say what to do


def test_an_input_that_cannot_be_counted_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="Line9"):
        capture(tmp_path, WIRED, pulses=("Line2", "Line9"))
