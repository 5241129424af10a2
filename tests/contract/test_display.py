"""The mock panels keep the contract of displays; what only they can show."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.devices import Display
from pdcd.bench.tables import Config, PanelConfig
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


def mock_display(config: Config) -> Display:
    return Rig(config).display


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


def with_mask(folder: Path, **mask: Any) -> Config:
    return bench_rig.config(folder, mask=PanelConfig(size_px=(1600, 1200), **mask))


def test_equal_panels_keep_their_phase(tmp_path: Path) -> None:
    display = mock_display(with_mask(tmp_path, phase_s=0.005))
    display.load(frames())
    log = display.play(lambda *_: None, lambda: False)
    assert not log.missed.any()
    # The first commit falls between any two vblanks: the mask lags by its phase, or leads.
    np.testing.assert_allclose((log.dual_ns - log.primal_ns) % (1e9 / 60), 5e6, atol=2)


def test_unequal_rates_slip_and_cost_a_refresh_each_time_around(tmp_path: Path) -> None:
    """60 against 59.4 Hz: the slower throttles both; a refresh is lost each 1/0.6 s."""
    display = mock_display(with_mask(tmp_path, refresh_hz=59.4))
    display.load(frames(128))
    log = display.play(lambda *_: None, lambda: False)
    seconds = (log.end_ns.max() - log.primal_ns[0]) * 1e-9
    assert log.missed.sum() == pytest.approx(seconds * 0.6, abs=1.0)
    assert len(log) / seconds == pytest.approx(59.4, rel=2e-3)
