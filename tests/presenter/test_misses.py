"""Refreshes that come late on a real X server: all of them are found, and nothing else is."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from pdcd.interfaces import FrameLog
from tests import x11_rig
from tests.contract.test_display import frames
from tests.xserver import XServer

STALLS = (50, 130, 233, 340, 451, 560)
TRIES = 4
"""A machine that does other work too may well lose a refresh that nobody took away."""


def log_of(folder: Path, server: XServer, codes: int, **options: object) -> FrameLog:
    display = x11_rig.display(x11_rig.config(folder, server, more=options))
    display.connect()
    try:
        display.load(frames(codes))
        return display.play(lambda *_: None, lambda: False)
    finally:
        display.disconnect()


def test_every_stall_of_30_ms_costs_one_refresh_and_is_found(
    tmp_path: Path, x_quarter: XServer
) -> None:
    stalls = {str(row): 30.0 for row in STALLS}
    for _ in range(TRIES):
        log = log_of(tmp_path, x_quarter, 200, stalls_ms=stalls)
        assert len(log) == 600
        late = np.flatnonzero(log.missed)
        assert set(late) >= {row + 1 for row in STALLS}
        if late.size == len(STALLS):
            break
    np.testing.assert_array_equal(late, np.array(STALLS) + 1)
    np.testing.assert_array_equal(log.missed[late], 1)
    # The stamps say the same as the counts: two refreshes of 1/60 s where one was lost.
    lasted = np.diff(log.primal_ns)[late - 1] * 60e-9
    np.testing.assert_allclose(lasted, 2.0, atol=0.3)


def test_no_false_alarms(tmp_path: Path, x_quarter: XServer) -> None:
    missed = [int(log_of(tmp_path, x_quarter, 200).missed.sum()) for _ in range(1)]
    while min(missed) and len(missed) < TRIES:
        missed.append(int(log_of(tmp_path, x_quarter, 200).missed.sum()))
    assert min(missed) == 0, missed


@contextmanager
def busy() -> Iterator[None]:
    """A Python loop that keeps one core busy, in this session's own scheduling class."""
    loop = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        loop.kill()
        loop.wait()


@pytest.mark.skipif(os.geteuid() != 0, reason="real-time priority needs root or LimitRTPRIO")
def test_a_busy_core_costs_no_frame(tmp_path: Path, x_quarter: XServer) -> None:
    missed = []
    with busy():
        for _ in range(TRIES):
            missed.append(int(log_of(tmp_path, x_quarter, 100).missed.sum()))
            if not missed[-1]:
                break
    assert min(missed) == 0, missed


@pytest.mark.parametrize("source", ["present-msc", "clock"])
def test_time_sources_without_a_screen(tmp_path: Path, x_quarter: XServer, source: str) -> None:
    log = log_of(tmp_path, x_quarter, 20, time_source=source, stalls_ms={"30": 50.0})
    assert log.source == source and not log.verified
    assert log.missed[31] >= 2
    assert np.median(np.diff(log.primal_ns)) == pytest.approx(1e9 / 60, rel=0.03)
