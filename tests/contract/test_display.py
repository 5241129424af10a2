"""The mock panels keep the contract of displays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from pdcd.capture.rig import Rig
from pdcd.codes.make import make_codes
from pdcd.panels.frames import Frames
from pdcd.panels.schedule import build_frames
from pdcd.testing import DisplayContract
from tests import bench_rig

GRID = bench_rig.GRID


def frames(count: int = 8, grid: tuple[int, int] = GRID) -> Frames:
    codes = make_codes("balanced", grid, count, dual="complement")
    return build_frames(bench_rig.pairs(codes), grid, window="whole", schedule="full", passes=1)


class TestMockDisplay(DisplayContract):
    """The mock bench's panels."""

    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Rig]:
        rig = Rig(bench_rig.config(tmp_path))
        rig.connect()
        yield rig
        rig.disconnect()

    def find_lit(self, rig: Rig) -> bool:
        return not bench_rig.are_panels_black(bench_rig.bench_of_rig(rig))
