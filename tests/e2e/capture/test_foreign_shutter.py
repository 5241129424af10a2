"""A real shutter's driver before the mock camera, which learns of the exposure from the rig."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, DisplayConfig, FaultsConfig, RigConfig
from pdcd.capture.engine import Engine
from pdcd.errors import ExposureError
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig, whole_rig
from tests.e2e.capture.test_whole_rig import images
from tests.fake_serial import FakeLine, fake_line
from tests.taken import capture_on

REQUEST = CaptureRequest(goal="indirect", codes=16, black_level="none")
CAMERA = CameraConfig(noise="none", f_number=8.0)


@contextmanager
def cabled(config: Config) -> Iterator[tuple[Engine, FakeLine]]:
    """The engine of a mock bench with a cable release, started."""
    engine = Engine.from_config(config)
    with fake_line("cable", engine._rig.clock) as line:
        engine.start()
        try:
            yield engine, line
        finally:
            engine.stop()


def test_the_pictures_are_those_of_the_mock_shutter(tmp_path: Path) -> None:
    for name in ("mock", "cable"):
        (tmp_path / name).mkdir()
    expected = images(capture_on(bench_rig.config(tmp_path / "mock", camera=CAMERA), REQUEST))
    config = bench_rig.config(tmp_path / "cable", camera=CAMERA, trigger=whole_rig.BLIND)
    with cabled(config) as (engine, line):
        found = images(bench_rig.capture(engine, REQUEST))
        assert sum(line.levels("rts")) == 2  # white and coded
        with pytest.raises(ExposureError, match="no finished exposure"):
            engine._rig.readout.fetch(tmp_path, "again", 1.0)  # its photo was taken already
    for name in expected:
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)


def test_a_spoilt_exposure_is_fetched_and_taken_again(tmp_path: Path) -> None:
    config = bench_rig.config(
        tmp_path,
        camera=CAMERA,
        trigger=whole_rig.BLIND,
        rig=RigConfig(on_miss="abort", retries=1),
        display=DisplayConfig(faults=FaultsConfig(stale_mask=(4,), exposures=2)),
    )
    with cabled(config) as (engine, line):
        result = bench_rig.capture(engine, REQUEST)
        assert result.state == "done", result.error
        assert sum(line.levels("rts")) == 3
    assert any("discarded" in name for name in result.files)


def test_an_open_shutter_has_no_photo(tmp_path: Path) -> None:
    with cabled(bench_rig.config(tmp_path, camera=CAMERA, trigger=whole_rig.BLIND)) as (engine, _):
        assert bench_rig.capture(engine, REQUEST).state == "done"
        rig = engine._rig
        rig._context.shared.exposed_ns = None
        rig.shutter.open()
        with pytest.raises(ExposureError, match="no finished exposure"):
            rig.readout.fetch(tmp_path, "early", 1.0)
