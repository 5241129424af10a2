"""How well panels keep time: figures of a log that is known, and what is shown to get one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from pdcd.bench.tables import DisplayConfig, PanelConfig, RigConfig
from pdcd.errors import ConfigError
from pdcd.panels.frames import BLACK
from pdcd.presenter import timing
from pdcd.presenter.messages import LOG_COLUMNS, Column, Ready
from pdcd.presenter.timing import (
    RefreshTiming,
    draw_histogram,
    make_random_codes,
    measure_refreshes,
)
from tests import bench_rig

READY = Ready("clock", 100.0, {})

MS = 1_000_000


def log(count: int = 4) -> np.ndarray[Any, Any]:
    """Refresh n at 10 n ms, the third one late; drawn 2 + n ms after the one before, for 0.5 ms."""
    found = np.zeros((count, LOG_COLUMNS), dtype=np.int64)
    number = np.arange(count)
    found[:, Column.MSC] = 100 + number + (number >= 2)
    found[:, Column.NS] = 10 * MS * found[:, Column.MSC]
    found[1:, Column.PUT_NS] = found[:-1, Column.NS] + (2 + number[1:]) * MS
    found[0, Column.PUT_NS] = 5 * MS
    found[:, Column.SWAP_NS] = found[:, Column.PUT_NS] + MS // 2
    found[0, Column.SWAP_NS] += 3 * MS
    found[:, Column.CPU_NS] = number * number * MS
    return found


def test_times_of_a_log_are_differences_of_its_stamps() -> None:
    found = RefreshTiming.of(log(), READY)
    np.testing.assert_allclose(found.interval_s, [0.010, 0.020, 0.010])
    np.testing.assert_array_equal(found.missed, [0, 1, 0])
    np.testing.assert_allclose(found.late_s, [0.003, 0.004, 0.005])
    np.testing.assert_allclose(found.draw_s, [0.0005] * 3)
    np.testing.assert_allclose(found.cpu_s, [0.001, 0.003, 0.005])
    assert found.first_draw_s == pytest.approx(0.0035)


def test_a_table_has_the_middle_the_worst_of_a_hundred_and_the_worst() -> None:
    rows = {name: values for name, *values in RefreshTiming.of(log(), READY).table()}
    assert list(rows) == ["refresh to refresh", "vblank to drawing", "drawing", "processor time"]
    assert rows["refresh to refresh"] == pytest.approx([10.0, 19.8, 20.0])
    assert rows["vblank to drawing"] == pytest.approx([4.0, 4.98, 5.0])
    assert rows["drawing"] == pytest.approx([0.5] * 3)
    assert rows["processor time"] == pytest.approx([3.0, 4.96, 5.0])


def test_codes_to_time_by_are_guarded_and_complementary() -> None:
    frames = make_random_codes((6, 9))
    assert len(frames) == 3 * 64 and (frames.grid, frames.lattice) == ((6, 9), (6, 9))
    codes = frames.dual_index[1::3]
    np.testing.assert_array_equal(codes, np.arange(64))
    for at in (0, 2):
        assert (frames.dual_index[at::3] == BLACK).all() and frames.guard[at::3].all()
        np.testing.assert_array_equal(frames.primal_index[at::3], codes)  # lit before and after
    assert not frames.guard[1::3].any() and not frames.shift.any()
    both = np.unpackbits(np.stack([frames.primal_patterns, frames.dual_patterns]), axis=2)
    sums = both.sum(axis=0)[:, :54]
    assert (sums == 1).all()
    assert 0.4 < both[0][:, :54].mean() < 0.6
    assert len(np.unique(frames.primal_patterns, axis=0)) == 64


class Process:
    """Stands in for the display process."""

    made: list[Process]

    def __init__(self, request: Any) -> None:
        self.ready, self.closed = READY, 0
        self.loaded: Any = None
        self.sent: list[Any] = []
        self.made.append(self)

    def load(self, frames: Any) -> None:
        self.loaded = frames

    def play(self, primal: Any, dual: Any, progress: Any, cancelled: Any) -> Any:
        progress(1, 0)
        assert not cancelled()
        self.sent = [primal, dual]
        if len(primal) == 13:
            raise ArithmeticError
        return log(len(primal) + 1)

    def close(self) -> None:
        self.closed += 1


@pytest.mark.parametrize(("refreshes", "planes"), [(200, 1), (20, 24), (13, 1)])
def test_so_many_refreshes_are_shown_and_the_process_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refreshes: int, planes: Literal[1, 24]
) -> None:
    monkeypatch.setattr(timing, "DisplayProcess", Process)
    Process.made = []
    size = (256, 192)
    config = bench_rig.config(
        tmp_path,
        rig=RigConfig(clock="real"),
        projector=PanelConfig(size_px=size),
        mask=PanelConfig(size_px=size),
        display=DisplayConfig(
            driver="x11", options={"projector": "A", "mask": "B"}, planes_per_refresh=planes
        ),
    )
    if refreshes == 13:
        with pytest.raises(ArithmeticError):
            measure_refreshes(config, refreshes)
    else:
        found = measure_refreshes(config, refreshes)
        assert found.interval_s.size == refreshes and found.ready is READY
    (process,) = Process.made
    assert process.closed == 1 and process.loaded.grid == (48, 64)
    for sent in process.sent:
        assert sent.shape == (refreshes, planes) and sent.dtype == np.int32
        np.testing.assert_array_equal(sent.ravel(), np.arange(sent.size) % 192)


def test_a_picture_is_drawn(tmp_path: Path) -> None:
    seconds = np.array([0.010, 0.020, 0.030])
    timing = RefreshTiming(
        Ready("swap", 100.0, {}), seconds, np.array([0, 1, 2]), seconds, seconds, seconds / 10, 0.0
    )
    draw_histogram(timing, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_without_the_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ConfigError, match=r"needs matplotlib \(.* install matplotlib\)"):
        draw_histogram(RefreshTiming.of(log(), READY), Path("a.png"))
