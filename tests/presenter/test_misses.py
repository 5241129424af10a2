"""Refreshes that come late on a real X server: all of them are found, and nothing else is."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, RigConfig
from pdcd.capture.engine import Engine
from pdcd.errors import Cancelled
from pdcd.panels.frames import FrameLog
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from tests import bench_rig, lateness, x11_rig
from tests.contract.test_display import frames
from tests.xserver import XServer

pytestmark = pytest.mark.timeout(180)  # up to three runs of 10 s on a busy machine

STALLS = (50, 130, 233, 340, 451, 560)
TRIES = 5
"""A machine that does other work too may well lose a refresh that nobody took away; a pass is ended
when it does."""
SLACK = 12
"""A count of lost refreshes may be newer than that of shown ones by less than so many refreshes."""

Play = Callable[[tuple[int, ...]], FrameLog]


@contextmanager
def playing(folder: Path, server: XServer, codes: int, **options: object) -> Iterator[Play]:
    """Plays codes, three refreshes each, and ends a pass that loses any refresh after others than
    those given: raises Cancelled."""
    display = x11_rig.display(x11_rig.config(folder, server, more=options))
    display.connect()

    def play(lost_after: tuple[int, ...]) -> FrameLog:
        spoilt = False

        def look(shown: int, _: int, missed: int) -> None:
            nonlocal spoilt
            spoilt = missed > sum(row < shown + SLACK for row in lost_after)

        return display.play(look, lambda: spoilt)

    try:
        display.load(frames(codes))
        yield play
    finally:
        display.disconnect()


def log_of(folder: Path, server: XServer, codes: int, **options: object) -> FrameLog:
    """One pass, whatever is lost in it."""
    with playing(folder, server, codes, **options) as play:
        return play(tuple(range(3 * codes)))


def until_quiet(play: Play, lost_after: tuple[int, ...]) -> FrameLog:
    """The first of a few logs that lost one refresh after each of these rows and no other; skips
    where the machine itself was late meanwhile."""
    wanted = np.array(lost_after, dtype=np.intp) + 1
    with lateness.watched() as machine:
        for _ in range(TRIES):
            try:
                log = play(lost_after)
            except Cancelled:
                continue
            check(log)
            late = np.flatnonzero(log.missed)
            assert set(late.tolist()) >= set(wanted.tolist())  # on any machine
            if late.size == wanted.size and np.all(log.missed[late] == 1):
                return log
    machine.quiet_or_skip(f"it spoilt all of {TRIES} passes")
    pytest.fail(f"refreshes were lost in all of {TRIES} passes on a machine that was in time")


def check(log: FrameLog) -> None:
    """Counts and stamps are measured apart and must tell of the same refreshes.

    A made-up vblank on a busy machine may come up to a quarter late, or a few in a row anyhow.
    """
    lasted = np.diff(np.append(log.primal_ns, log.end_ns[0])) * 60e-9
    counted = 1 + log.missed[1:]
    np.testing.assert_allclose(lasted[:-1], counted, atol=0.8)


@pytest.mark.long
def test_every_stall_of_30_ms_costs_one_refresh_and_is_found(
    tmp_path: Path, x_quarter: XServer
) -> None:
    stalls = {str(row): 30.0 for row in STALLS}
    with playing(tmp_path, x_quarter, 200, stalls_ms=stalls) as play:
        log = until_quiet(play, STALLS)
    assert len(log) == 600
    np.testing.assert_array_equal(np.flatnonzero(log.missed), np.array(STALLS) + 1)


@pytest.mark.long
def test_no_false_alarms(tmp_path: Path, x_quarter: XServer) -> None:
    """Beside the 594 refreshes between the stalls."""
    with playing(tmp_path, x_quarter, 100) as play:
        assert not until_quiet(play, ()).missed.any()


@contextmanager
def busy() -> Iterator[None]:
    """A Python loop that keeps one core busy, in this session's own scheduling class."""
    loop = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        loop.kill()
        loop.wait()


@pytest.mark.long
@pytest.mark.skipif(os.geteuid() != 0, reason="real-time priority needs root or LimitRTPRIO")
def test_a_busy_core_costs_no_frame(tmp_path: Path, x_quarter: XServer) -> None:
    with playing(tmp_path, x_quarter, 60) as play, busy():
        assert not until_quiet(play, ()).missed.any()


def capture(folder: Path, server: XServer, on_miss: str, exposures: int) -> CaptureResult:
    """A capture whose first exposures, all for 0, have two codes stretched.

    On a busy machine others may be spoilt, too: then they are taken again more often.
    """
    stalls = {"4": 30.0, "16": 30.0}  # refreshes 3 n + 1 have the mask open
    rig = RigConfig(clock="real", on_miss=on_miss, settle_s=0.02, retries=12 if exposures else 3)  # type: ignore[arg-type]
    config = x11_rig.config(
        folder, server, rig=rig, more={"stalls_ms": stalls, "stall_exposures": exposures}
    )
    fixed = CameraConfig(noise="none", f_number=8.0)
    engine = Engine.from_config(msgspec.structs.replace(config, camera=fixed))
    engine.start()
    try:
        request = CaptureRequest(goal="indirect", codes=12, window="whole", white=False)
        return bench_rig.capture(engine, request)
    finally:
        engine.stop()


def warnings_of(result: CaptureResult) -> str:
    assert result.folder is not None
    return str(json.loads((Path(result.folder) / "capture.json").read_text())["warnings"])


@pytest.mark.whole
def test_policy_abort_takes_the_exposure_again(tmp_path: Path, x_quarter: XServer) -> None:
    result = capture(tmp_path, x_quarter, "abort", 1)
    assert result.state == "done", result.error
    assert "exposure 1 was discarded: a code was shown" in warnings_of(result)


@pytest.mark.long
def test_policy_abort_gives_up(tmp_path: Path, x_quarter: XServer) -> None:
    result = capture(tmp_path, x_quarter, "abort", 0)
    assert result.state == "failed"
    assert result.error is not None and result.error["kind"] == "sync"
    assert not x11_rig.root_pixels(x_quarter).any()


@pytest.mark.long
def test_policy_balance_evens_the_codes_in_the_same_exposure(
    tmp_path: Path, x_quarter: XServer
) -> None:
    with lateness.watched() as machine:
        result = capture(tmp_path, x_quarter, "balance", 1)
    if result.state != "done" or "discarded" in warnings_of(result):
        # Further refreshes were lost where no pass can make up for them.
        machine.quiet_or_skip("it spoilt an exposure")
    assert result.state == "done", result.error
    refreshes = result.summary["refreshes"]
    # One pass, a black row, and at least the ten codes that were not stretched once more.
    assert isinstance(refreshes, int) and refreshes >= 36 + 1 + 30


@pytest.mark.whole
def test_policy_flag_keeps_and_tells(tmp_path: Path, x_quarter: XServer) -> None:
    result = capture(tmp_path, x_quarter, "flag", 0)
    assert result.state == "done", result.error
    assert "refreshes were missed" in warnings_of(result)
    missed = result.summary["missed_refreshes"]
    assert isinstance(missed, int) and missed >= 2


@pytest.mark.long
@pytest.mark.parametrize("source", ["present-msc", "clock"])
def test_time_sources_without_a_screen(tmp_path: Path, x_quarter: XServer, source: str) -> None:
    log = log_of(tmp_path, x_quarter, 20, time_source=source, stalls_ms={"30": 50.0})
    assert log.source == source and not log.verified
    assert log.missed[31] >= 2
    assert np.median(np.diff(log.primal_ns)) == pytest.approx(1e9 / 60, rel=0.03)
