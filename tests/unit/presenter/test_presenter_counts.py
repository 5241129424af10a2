"""Refreshes that a swap took, and what may be called verified."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.x11 import X11Display, build_frame_log
from pdcd.bench.devices import SharedState
from pdcd.bench.tables import PanelConfig
from pdcd.panels.frames import FrameLog
from pdcd.presenter.clocks import SwapReturns
from pdcd.presenter.messages import LOG_COLUMNS, Ready
from tests import bench_rig

PERIOD_NS = 16_667_000
NS, MSC, FLIPPED = 0, 1, 5
"""Columns of the log that the display process writes."""


@pytest.mark.parametrize("periods", [1, 2, 3])
def test_a_swap_of_several_periods_is_several_refreshes(
    monkeypatch: pytest.MonkeyPatch, periods: int
) -> None:
    """A little early or late, as real ones return."""
    now_ns = 10 * PERIOD_NS
    monkeypatch.setattr(time, "monotonic_ns", lambda: now_ns)
    source = SwapReturns(lambda: None, lambda: None, float(PERIOD_NS))
    before = source.msc
    for jitter_ns in (-2_000_000, 2_000_000, 0):
        now_ns += periods * PERIOD_NS + jitter_ns
        source.shown()
        assert source.ns == now_ns
    assert source.msc - before == 3 * periods


def test_a_swap_that_returns_at_once_is_one_refresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "monotonic_ns", lambda: 10 * PERIOD_NS)
    source = SwapReturns(lambda: None, lambda: None, float(PERIOD_NS))
    source.shown()
    assert source.msc == 1


def made(source: str, flipped: list[int], msc: list[int]) -> FrameLog:
    log = np.zeros((len(msc), LOG_COLUMNS), dtype=np.int64)
    log[:, NS] = np.array(msc) * PERIOD_NS
    log[:, MSC] = msc
    log[:, FLIPPED] = flipped
    rows = np.arange(len(msc) - 1, dtype=np.int32)
    return build_frame_log(rows, rows, log, Ready(source, 60.0, {}))


def test_one_refresh_that_was_copied_is_no_proof() -> None:
    """Only page flips, all of them, and only where completions are reported."""
    msc = [5, 6, 7, 8]
    assert made("present-complete", [1, 1, 1, 1], msc).verified
    for at in range(4):
        flipped = [int(n != at) for n in range(4)]
        assert not made("present-complete", flipped, msc).verified
    assert not made("present-msc", [1, 1, 1, 1], msc).verified


def test_lost_refreshes_belong_to_the_row_that_came_late() -> None:
    assert made("present-msc", [0] * 5, [5, 6, 9, 10, 12]).missed.tolist() == [0, 0, 2, 0]


@pytest.mark.parametrize("measured_s", [None, 0.004])
def test_the_lag_of_the_mask_counts_its_skew_against_the_projectors(
    tmp_path: Path, measured_s: float | None
) -> None:
    """A mask of 5 ms beside a projector of 2 ms lags by 3 ms more than the swaps tell."""
    size = (256, 192)
    config = bench_rig.config(
        tmp_path,
        projector=PanelConfig(size_px=size, skew_s=0.002),
        mask=PanelConfig(size_px=size, skew_s=0.005),
    )
    display = X11Display(config, None, SharedState())  # type: ignore[arg-type]
    lag_s = display._mask_lag_s(SimpleNamespace(lag_s=measured_s))  # type: ignore[arg-type]
    assert lag_s == (None if measured_s is None else pytest.approx(0.007))
