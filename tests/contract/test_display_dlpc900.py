"""Two DMDs keep the contract of displays, on scripted devices, however they start."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from pdcd.bench.devices import Display
from pdcd.capture.rig import Rig
from pdcd.testing import DisplayContract
from tests import bench_rig
from tests.dlpc900_rig import Dlpc900Rig


class TestDlpc900Display(DisplayContract):
    """Started by the computer; the projector's output starts the mask, or each by itself."""

    @pytest.fixture(params=["chain", "software"])
    def rig(self, request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Rig]:
        devices = Dlpc900Rig(start=request.param)
        devices.dmds[0].wired = devices.dmds[1]
        mock, dmds = bench_rig.config(tmp_path), devices.config()
        rig = Rig(
            msgspec.structs.replace(
                mock, projector=dmds.projector, mask=dmds.mask, display=dmds.display
            )
        )
        rig.context.shared.usb_backend = devices.usb
        for dmd in devices.dmds:
            dmd.clock = rig.clock
        self.devices = devices
        rig.display.connect()
        yield rig
        rig.disconnect()

    def make_fresh(self, rig: Rig) -> Display:
        return self.devices.make()

    def find_lit(self, rig: Rig) -> bool:
        return not all(dmd.black for dmd in self.devices.dmds)
