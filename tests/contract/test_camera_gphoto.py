"""The gphoto2 drivers through the real libgphoto2, on a virtual camera in another process.

In another process because some calls of libgphoto2 let no other thread of theirs run.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

pytest.importorskip("gphoto2", reason="gphoto2 IS MISSING: see .venv/gphoto2.log")

from pdcd.bench.devices import CameraSettings
from pdcd.bench.tables import CameraConfig, RigConfig, TriggerConfig
from pdcd.capture.rig import Rig
from pdcd.errors import DeviceLost, PdcdError
from pdcd.testing import ReadoutContract, ShutterContract
from tests import bench_rig
from tests.places import ROOT


class Camera(NamedTuple):
    """The process of a virtual camera and its port."""

    process: subprocess.Popen[str]
    port: str


@contextmanager
def virtual_camera() -> Iterator[Camera]:
    """A virtual camera in a process of its own, whose first line names the port."""
    process = subprocess.Popen(
        [sys.executable, "-m", "pdcd", "virtual-camera", "--port", "0", "--small"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    yield Camera(process, process.stdout.readline().split()[-1])
    process.kill()
    process.wait()
    process.stdout.close()


@contextmanager
def connected(camera: Camera, folder: Path) -> Iterator[Rig]:
    """A rig whose shutter and readout are that camera's."""
    config = bench_rig.config(
        folder,
        rig=RigConfig(clock="real"),
        trigger=TriggerConfig(driver="gphoto2"),
        camera=CameraConfig(
            driver="gphoto2",
            f_number=8.0,
            options={"port": camera.port, "model": "PTP/IP Camera"},
        ),
    )
    rig = Rig(config)
    rig.shutter.connect()
    rig.readout.connect()
    yield rig
    for device in (rig.shutter, rig.readout):
        try:
            device.disconnect()
        except PdcdError:
            assert camera.process.poll() is not None  # only where the test took the camera away


@pytest.fixture(scope="module")
def camera() -> Iterator[Camera]:
    """One camera for all tests, each of which has a session of its own with it."""
    with virtual_camera() as camera:
        yield camera


class OnThatCamera:
    @pytest.fixture
    def rig(self, camera: Camera, tmp_path: Path) -> Iterator[Rig]:
        with connected(camera, tmp_path) as rig:
            yield rig


class TestGphotoShutter(OnThatCamera, ShutterContract):
    """Bulb."""

    @pytest.fixture(autouse=True)
    def drained(self, rig: Rig) -> Iterator[None]:
        """Nobody fetches these photos, and the camera's memory holds five."""
        yield
        rig.readout.arm(CameraSettings(iso=100, f_number=8.0))


class TestGphotoReadout(OnThatCamera, ReadoutContract):
    """RAM capture."""

    def test_it_is_known_by_its_name_and_lists(self, rig: Rig) -> None:
        info = rig.readout.connect()
        assert info.model == "Canon EOS 450D"
        assert info.isos == (100, 200, 400, 800, 1600)
        assert 8.0 in info.f_numbers

    def test_no_file_of_ours_is_closed(self, rig: Rig) -> None:
        """libgphoto2 closes file descriptor 0 on its way out."""
        before = os.fstat(0)
        for device in (rig.shutter, rig.readout):
            device.disconnect()
        assert os.path.samestat(os.fstat(0), before)

    def test_a_camera_that_goes_away_is_lost(self, tmp_path: Path) -> None:
        with virtual_camera() as camera, connected(camera, tmp_path) as rig:
            rig.readout.arm(CameraSettings(iso=100, f_number=8.0))
            rig.shutter.open()
            camera.process.kill()
            camera.process.wait()
            with pytest.raises(DeviceLost):
                rig.shutter.close()
