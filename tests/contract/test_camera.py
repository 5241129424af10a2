"""The mock bench keeps the contract of shutters and readouts, and shows what only it can show."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.devices import CameraInfo
from pdcd.capture.rig import Rig
from pdcd.testing import ReadoutContract, ShutterContract
from tests import bench_rig


class OnTheMockBench:
    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        rig = Rig(bench_rig.config(tmp_path))
        rig.connect()
        yield rig
        rig.disconnect()


class TestMockShutter(OnTheMockBench, ShutterContract):
    """Blades with a lag."""

    def find_open(self, rig: Rig) -> bool:
        return bench_rig.bench_of_rig(rig).shutter_open

    def test_it_really_moves_between_the_command_and_the_promise(self, rig: Rig) -> None:
        bench = bench_rig.bench_of_rig(rig)
        before = rig.clock.now_ns()
        sure = rig.shutter.open()
        assert bench.open_ns is not None and before <= bench.open_ns <= sure


class TestMockReadout(OnTheMockBench, ReadoutContract):
    """A sensor with noise, in front of a scene."""

    def test_panels_that_stay_black_leave_a_dark_frame(
        self, rig: Rig, info: CameraInfo, tmp_path: Path
    ) -> None:
        self.expose(rig, info)
        assert np.abs(self.fetch(rig, info, tmp_path).planes).max() == 0.0


class TestSeveralQuadsPerCell(ReadoutContract):
    """Each repeats its cell."""

    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        camera = type(bench_rig.config(tmp_path).camera)(noise="none", quads_per_cell=3)
        rig = Rig(bench_rig.config(tmp_path, camera=camera))
        rig.connect()
        yield rig
        rig.disconnect()

    def test_the_frame_is_so_much_larger(self, rig: Rig, info: CameraInfo, tmp_path: Path) -> None:
        self.expose(rig, info)
        assert self.fetch(rig, info, tmp_path).planes.shape == (4, 9, 12)
