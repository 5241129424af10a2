"""The PTP drivers keep the contract of shutters and readouts: on a virtual USB, and on a bench.

On a bench: ``PDCD_TEST_PTP=04a9:3145`` names the camera, which stands on M, in manual focus, with
RAW set, and the tests marked ``bench`` run on it. They were never run so far.
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

BENCH = os.environ.get("PDCD_TEST_PTP")
on_a_bench = pytest.mark.skipif(not BENCH, reason="PDCD_TEST_PTP names no camera")


def make(folder: Path, options: dict[str, Any], clock: Literal["virtual", "real"]) -> Rig:
    rig = Rig(
        bench_rig.config(
            folder,
            camera=CameraConfig(driver="ptp", noise="none", options=options),
            trigger=TriggerConfig(driver="ptp"),
            rig=RigConfig(clock=clock),
        )
    )
    rig.connect()
    return rig


class OnVirtualUsb:
    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        rig = make(tmp_path, {"usb": "virtual"}, "virtual")
        yield rig
        rig.disconnect()


@pytest.mark.bench
@on_a_bench
class OnABench:
    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        rig = make(tmp_path, {"id": BENCH}, "real")
        yield rig
        rig.disconnect()


class TestPtpShutter(OnVirtualUsb, ShutterContract):
    """BulbStart and BulbEnd."""


class TestPtpReadout(OnVirtualUsb, ReadoutContract):
    """Settings and photos."""


class TestPtpShutterOnABench(OnABench, ShutterContract):
    """A real body."""


class TestPtpReadoutOnABench(OnABench, ReadoutContract):
    """A real body."""
