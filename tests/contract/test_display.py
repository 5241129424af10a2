"""What every Display driver must do, in one class, and what the mock panels do beyond it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.devices import Display
from pdcd.bench.tables import Config, PanelConfig
from pdcd.capture.rig import Rig
from pdcd.codes.make import make_codes
from pdcd.errors import Cancelled, ConfigError
from pdcd.panels.frames import Frames
from pdcd.panels.schedule import build_frames
from tests import bench_rig

GRID = bench_rig.GRID


def frames(count: int = 8, grid: tuple[int, int] = GRID) -> Frames:
    codes = make_codes("balanced", grid, count, dual="complement")
    return build_frames(bench_rig.pairs(codes), grid, window="whole", schedule="full", passes=1)


def mock_display(config: Config) -> Display:
    return Rig(config).display


@pytest.fixture
def display(tmp_path: Path) -> Display:
    """The display that is tested, connected; another driver's test module overrides it."""
    display = mock_display(bench_rig.config(tmp_path))
    display.connect()
    return display


class DisplayContract:
    """Uses nothing but the Protocol."""

    def test_connect_reports_two_panels_and_a_refresh(self, display: Display) -> None:
        info = display.connect()
        assert min(info.primal_size_px + info.dual_size_px) > 0
        assert info.refresh_hz > 0.0

    def test_play_logs_every_refresh_in_order(self, display: Display) -> None:
        asked = frames()
        display.load(asked)
        log = display.play(lambda *_: None, lambda: False)
        assert len(log) == len(asked)
        assert np.all(np.diff(log.primal_ns) > 0) and np.all(np.diff(log.dual_ns) > 0)
        assert log.end_ns[0] > log.primal_ns[-1] and log.end_ns[1] > log.dual_ns[-1]

    def test_a_load_serves_several_plays(self, display: Display) -> None:
        display.load(frames())
        first = display.play(lambda *_: None, lambda: False)
        second = display.play(lambda *_: None, lambda: False)
        assert second.primal_ns[0] > first.end_ns.max() - 1

    def test_progress_ends_at_the_last_refresh(self, display: Display) -> None:
        seen: list[tuple[int, int, int]] = []
        asked = frames(24)
        display.load(asked)
        display.play(lambda *a: seen.append(a), lambda: False)
        assert seen[0][0] == 0
        assert seen[-1][:2] == (len(asked), len(asked))
        assert [s[0] for s in seen] == sorted(s[0] for s in seen)

    def test_cancel_raises(self, display: Display) -> None:
        display.load(frames())
        with pytest.raises(Cancelled):
            display.play(lambda *_: None, lambda: True)

    def test_black_is_safe_in_every_state(self, display: Display) -> None:
        display.black()
        display.show(frames())
        display.black()
        display.black()
        display.disconnect()
        display.disconnect()

    def test_play_without_load_is_refused(self, display: Display) -> None:
        with pytest.raises(ConfigError, match="no frames"):
            display.play(lambda *_: None, lambda: False)


class TestMockDisplay(DisplayContract):
    """The mock bench's panels."""

    def test_cells_that_do_not_fit_are_refused(self, tmp_path: Path) -> None:
        small = PanelConfig(size_px=(3, 2))
        display = mock_display(bench_rig.config(tmp_path, projector=small))
        with pytest.raises(ConfigError, match="have no pixel"):
            display.load(frames())


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
