"""The contract tests on the drivers serial, folder and gphoto2, and on a bench of one's own.

The camera of the first two is a fake one on a cable: it listens to the serial line and saves its
RAW file in the watched folder, as tethering software does.

On real devices: ``PDCD_TEST_CONFIG=my.toml pytest -m bench tests/contract``. The configuration's
shutter and readout are used; the lens cap may stay on.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.config import load_config
from pdcd.bench.devices import CameraSettings
from pdcd.bench.tables import CameraConfig, TriggerConfig
from pdcd.capture.rig import Rig
from pdcd.sensor.raw import read_raw
from tests import bench_rig
from tests.contract.test_camera import ReadoutContract, ShutterContract, expose, fetched
from tests.dng_file import write_dng
from tests.fake_serial import Edge, fake_line

BENCH = "PDCD_TEST_CONFIG"


class Camera:
    """In bulb mode on a cable; every exposure becomes a file in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._opened_ns: int | None = None
        self.count = 0

    def listen(self, edge: Edge) -> None:
        """The release: pressed by RTS."""
        if edge.line != "rts":
            return
        if edge.level:
            self._opened_ns = edge.t_ns
        elif self._opened_ns is not None:
            self.count += 1
            write_dng(
                self._folder / f"IMG_{self.count:04d}.DNG",
                np.full((48, 64), 512 + self.count, np.uint16),
                black=512,
                white=16383,
                iso=100,
                exposure_s=(edge.t_ns - self._opened_ns) * 1e-9,
                f_number=8.0,
                model="camera on a cable",
                date=datetime.now(),
            )
            self._opened_ns = None


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    """A rig with a cable release and a watched folder."""
    folder = tmp_path / "card"
    folder.mkdir()
    config = bench_rig.config(
        tmp_path,
        trigger=TriggerConfig(driver="serial", options={"port": "line://cable"}),
        camera=CameraConfig(
            driver="folder",
            f_number=8.0,
            options={"folder": str(folder)},
        ),
    )
    rig = Rig(config)
    with fake_line("cable", rig.clock) as line:
        line.on_edge = Camera(folder).listen
        rig.connect()
        yield rig
        rig.disconnect()


class TestSerialShutter(ShutterContract):
    """On a fake line."""


class TestFolderReadout(ReadoutContract):
    """With the cable release."""

    def test_each_exposure_brings_its_own_file(self, rig: Rig, tmp_path: Path) -> None:
        for number in (1, 2, 3):
            expose(rig)
            raw = fetched(rig, tmp_path, f"photo-{number}")
            assert np.all(read_raw(raw.path).planes == number)


class Hardware:
    """Takes the rig from a configuration file."""

    @pytest.fixture
    def rig(self) -> Iterator[Rig]:
        path = os.environ.get(BENCH)
        if path is None:
            pytest.skip(f"{BENCH} names no configuration of a bench")
        rig = Rig(load_config(path))
        rig.shutter.connect()
        rig.readout.connect()
        yield rig
        rig.shutter.disconnect()
        rig.readout.disconnect()


@pytest.mark.bench
class TestRealShutter(Hardware, ShutterContract):
    """The shutter of a bench."""


@pytest.mark.bench
class TestRealReadout(Hardware):
    """The camera of a bench: what can be asked of one without knowing its settings."""

    def test_a_file_comes_home_whole(self, rig: Rig, tmp_path: Path) -> None:
        info = rig.readout.connect()
        rig.readout.arm(CameraSettings(min(info.isos), max(info.f_numbers, default=None)))
        opened = rig.shutter.open()
        rig.clock.sleep_until_ns(opened + 10**9)
        rig.shutter.close()
        raw = fetched(rig, tmp_path, "photo", rig.config.camera.fetch_timeout_s)
        frame = read_raw(raw.path, sha256=raw.sha256, size_bytes=raw.size_bytes)
        assert frame.iso in (0, min(info.isos))
        assert frame.exposure_s == pytest.approx(1.0, abs=1.0)
