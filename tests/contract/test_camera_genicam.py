"""The drivers of machine-vision cameras keep the contract of shutters and readouts: on the virtual
one, over GigE Vision on this machine, and on a bench.

On a bench: ``PDCD_TEST_GENICAM=192.168.1.20``, or a serial number, names the camera, and the tests
marked ``bench`` run on it. They were never run so far.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import pytest

from pdcd.bench.tables import CameraConfig, RigConfig, TriggerConfig
from pdcd.capture.rig import Rig
from pdcd.testing import ReadoutContract, ShutterContract
from tests import bench_rig
from tests.genicam_rig import needs_aravis, turn

BENCH = os.environ.get("PDCD_TEST_GENICAM")
on_a_bench = pytest.mark.skipif(not BENCH, reason="PDCD_TEST_GENICAM names no camera")


def make(
    folder: Path, driver: str, options: dict[str, Any], clock: Literal["virtual", "real"]
) -> Rig:
    rig = Rig(
        bench_rig.config(
            folder,
            camera=CameraConfig(driver=driver, noise="none", options=options),
            trigger=TriggerConfig(driver=driver),
            rig=RigConfig(clock=clock),
        )
    )
    rig.connect()
    return rig


@needs_aravis
class OnThisMachine:
    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        with turn():
            rig = make(tmp_path, "virtual-genicam", {}, "virtual")
            yield rig
            rig.disconnect()


@pytest.mark.bench
@on_a_bench
class OnABench:
    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        rig = make(tmp_path, "genicam", {"camera": BENCH}, "real")
        yield rig
        rig.disconnect()


class TestGenicamShutter(OnThisMachine, ShutterContract):
    """A software trigger, and the camera's clock."""


class TestGenicamReadout(OnThisMachine, ReadoutContract):
    """Gain, and samples in memory."""


class TestGenicamShutterOnABench(OnABench, ShutterContract):
    """A real camera."""


class TestGenicamReadoutOnABench(OnABench, ReadoutContract):
    """A real camera."""
