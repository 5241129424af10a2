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
from typing import ClassVar

import numpy as np
import pytest

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import CameraConfig, TriggerConfig
from pdcd.capture.rig import Rig
from pdcd.testing import ReadoutContract, ShutterContract, make_rig
from tests import bench_rig
from tests.dng_file import write_dng
from tests.fake_serial import Edge, fake_line
from tests.fake_serial.lines import LINES

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


class OnACable:
    """A cable release and a watched folder."""

    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
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


class TestSerialShutter(OnACable, ShutterContract):
    """On a fake line."""

    def find_open(self, rig: Rig) -> bool:
        return LINES["cable"].levels("rts")[-1:] == [True]


class TestFolderReadout(OnACable, ReadoutContract):
    """With the cable release."""

    def test_each_exposure_brings_its_own_file(
        self, rig: Rig, info: CameraInfo, tmp_path: Path
    ) -> None:
        for number in (1, 2, 3):
            self.expose(rig, info)
            frame = self.fetch(rig, info, tmp_path, f"photo-{number}")
            assert np.all(frame.planes == number)


class OnABench:
    """What a configuration file names."""

    roles: ClassVar[tuple[str, ...]]

    @pytest.fixture
    def rig(self) -> Iterator[Rig]:
        path = os.environ.get(BENCH)
        if path is None:
            pytest.skip(f"{BENCH} names no configuration of a bench")
        rig = make_rig(path)
        for role in reversed(self.roles):
            getattr(rig, role).connect()
        yield rig
        rig.disconnect()


@pytest.mark.bench
class TestRealShutter(OnABench, ShutterContract):
    """The shutter of a bench."""


@pytest.mark.bench
class TestRealReadout(OnABench, ReadoutContract):
    """The camera of a bench."""

    exposure_s = 1.0
