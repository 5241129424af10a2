"""What every Shutter and Readout driver must do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.mock import MockBench
from pdcd.bench.devices import CameraSettings, RawFile, TimedShutter
from pdcd.capture.rig import Rig
from pdcd.errors import ConfigError, ExposureError
from pdcd.sensor.dng import CFAS
from pdcd.sensor.profile import NOMINAL_RESPONSIVITY_E
from pdcd.sensor.raw import read_raw
from tests import bench_rig

SETTINGS = CameraSettings(iso=100, f_number=8.0)


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    """The rig whose shutter and camera are tested; another driver's test module overrides it."""
    rig = Rig(bench_rig.config(tmp_path))
    rig.connect()
    return rig


def expose(rig: Rig, seconds: float = 0.5) -> None:
    rig.readout.arm(SETTINGS)
    opened = rig.shutter.open()
    rig.clock.sleep_until_ns(opened + round(seconds * 1e9))
    rig.shutter.close()


def fetched(rig: Rig, folder: Path, name: str, timeout_s: float = 5.0) -> RawFile:
    """The photo's file, also where the camera hands over samples."""
    return rig.stored(rig.readout.fetch(folder, name, timeout_s), folder, name)


class ShutterContract:
    """Uses nothing but the Protocol."""

    def test_it_may_be_told_how_long_the_exposure_will_be(self, rig: Rig) -> None:
        if not isinstance(rig.shutter, TimedShutter):
            pytest.skip("it does not want to know")
        rig.shutter.expect_exposure(0.1, 30.0)
        sure = rig.shutter.open()
        assert rig.shutter.close() >= sure
        rig.shutter.open()  # of this one nothing is known
        rig.shutter.close()

    def test_open_returns_when_it_is_surely_open(self, rig: Rig) -> None:
        before = rig.clock.now_ns()
        sure = rig.shutter.open()
        assert before <= sure <= rig.clock.now_ns()
        assert rig.shutter.close() >= sure

    def test_close_is_idempotent_and_safe_at_any_time(self, rig: Rig) -> None:
        rig.shutter.close()
        rig.shutter.open()
        first = rig.shutter.close()
        assert rig.shutter.close() >= first
        rig.shutter.disconnect()
        rig.shutter.disconnect()

    def test_connect_says_what_it_is(self, rig: Rig) -> None:
        assert all(isinstance(v, str) for v in rig.shutter.connect().values())


class ReadoutContract:
    """Uses nothing but the Protocol, and a shutter that goes with the camera."""

    def test_connect_says_what_it_is(self, rig: Rig) -> None:
        info = rig.readout.connect()
        assert info.model and info.isos
        assert info.responsivity_e.shape == (3,) and np.all(info.responsivity_e > 0)
        configured = rig.config.camera.responsivity_e
        assert tuple(info.responsivity_e) == (configured or NOMINAL_RESPONSIVITY_E)
        assert info.cfa in CFAS

    def test_iso_that_is_not_offered_is_refused_with_the_list(self, rig: Rig) -> None:
        with pytest.raises(ConfigError) as caught:
            rig.readout.arm(CameraSettings(iso=77, f_number=8.0))
        assert str(SETTINGS.iso) in str(caught.value)

    def test_a_file_comes_home_whole(self, rig: Rig, tmp_path: Path) -> None:
        expose(rig)
        raw = fetched(rig, tmp_path, "photo")
        assert raw.path.parent == tmp_path and raw.path.stem == "photo"
        assert raw.path.stat().st_size == raw.size_bytes
        frame = read_raw(raw.path, sha256=raw.sha256, size_bytes=raw.size_bytes)
        assert frame.iso == SETTINGS.iso
        # On a busy machine the shutter is closed late, never early.
        assert 0.4 < frame.exposure_s < 20.0

    def test_one_file_per_exposure(self, rig: Rig, tmp_path: Path) -> None:
        expose(rig)
        rig.readout.fetch(tmp_path, "photo", 5.0)
        with pytest.raises(ExposureError):
            rig.readout.fetch(tmp_path, "again", 5.0)

    def test_fetch_without_arm_is_refused(self, rig: Rig, tmp_path: Path) -> None:
        rig.shutter.open()
        rig.shutter.close()
        with pytest.raises(ExposureError, match="arm"):
            rig.readout.fetch(tmp_path, "photo", 5.0)

    def test_disconnect_twice(self, rig: Rig) -> None:
        rig.readout.disconnect()
        rig.readout.disconnect()


class TestMockShutter(ShutterContract):
    """The mock bench's shutter, and what only a virtual bench can show."""

    def test_it_really_moves_between_the_command_and_the_promise(self, rig: Rig) -> None:
        bench = MockBench.of(rig._context)
        before = rig.clock.now_ns()
        sure = rig.shutter.open()
        assert bench.open_ns is not None and before <= bench.open_ns <= sure
        assert bench.shutter_open
        rig.shutter.connect()
        assert not bench.shutter_open


class TestMockReadout(ReadoutContract):
    """The mock bench's camera."""


def test_panels_that_stay_black_leave_a_dark_frame(rig: Rig, tmp_path: Path) -> None:
    expose(rig)
    frame = read_raw(fetched(rig, tmp_path, "dark").path)
    assert np.abs(frame.planes).max() == 0.0


def test_several_quads_per_cell_repeat_the_cell(tmp_path: Path) -> None:
    camera = type(bench_rig.config(tmp_path).camera)(noise="none", quads_per_cell=3)
    rig = Rig(bench_rig.config(tmp_path, camera=camera))
    rig.connect()
    expose(rig)
    frame = read_raw(fetched(rig, tmp_path, "photo").path)
    assert frame.planes.shape == (4, 9, 12)
