"""A pass as its driver sees it: what is sent, told, stopped, and when it counts as hung."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.child import MessageLine
from pdcd.errors import Cancelled, DeviceLost, SyncError
from pdcd.panels.frames import BLACK
from pdcd.presenter.client import DisplayProcess
from pdcd.presenter.messages import (
    HEAD_SIZE,
    LOG_COLUMNS,
    DisplayReply,
    Done,
    Failed,
    Head,
    Play,
    map_shared_arrays,
)
from tests.unit.presenter.client_bench import HANG_S, Bench

# A pass.

COUNT = 6
"""Refreshes of a pass of three: two black ones before them, one after."""


class Pass:
    """Plays three refreshes; `steps` are taken one at each look, the answer comes after them."""

    def __init__(
        self, bench: Bench, process: DisplayProcess, reply: DisplayReply | None = None
    ) -> None:
        self.bench, self.process, self.reply = bench, process, reply or Done()
        self.told: list[tuple[int, int]] = []
        self.looks_s: list[float] = []
        self.steps: list[tuple[int, int, float]] = []
        self.cancel_at = self.fail_at = 99
        self.shown = COUNT
        self.message: Any = None
        self.arrays: dict[str, NDArray[Any]] = {}
        self.silent = False
        self.failure: Exception = ZeroDivisionError()
        process._line.wait = self.wait  # type: ignore[method-assign, assignment]

    def wait(self, within_s: float) -> bool:
        self.looks_s.append(within_s)
        if self.message is None:
            self.message, fd = self.bench.heard()
            assert fd is not None
            self.arrays = map_shared_arrays(fd, self.message.slots)
            os.close(fd)
        head = self.arrays["head"]
        if self.steps:
            head[Head.SHOWN], head[Head.MISSED], later_s = self.steps.pop(0)
            self.bench.clock.now_s += later_s
            return False
        head[Head.SHOWN] = self.shown
        self.arrays["log"][:, 0] = np.arange(COUNT)
        for name in ("projector_pictures", "mask_pictures"):
            if name in self.arrays:
                self.arrays[name][:, 0, 0] = np.arange(COUNT)
        self.bench.answer(self.reply)
        return True

    def progress(self, shown: int, missed: int) -> None:
        self.told.append((shown, missed))
        if len(self.told) == self.fail_at:
            if self.silent:
                self.bench.clock.silence(1.0)
            else:
                self.bench.answer(self.reply)
            raise self.failure

    def cancelled(self) -> bool:
        return len(self.told) >= self.cancel_at

    def play(self, **more: Any) -> NDArray[np.int64]:
        primal = np.array([[7], [8], [9]], dtype=np.int32)
        return self.process.play(primal, primal + 10, self.progress, self.cancelled, **more)


def test_a_pass_has_black_before_and_after_it_and_a_log_of_its_own_rows(
    bench: Bench, process: DisplayProcess
) -> None:
    made = Pass(bench, process)
    log = made.play(abort=True)
    assert isinstance(made.message, Play)
    assert (made.message.abort, made.message.stalls) == (True, True)
    arrays = made.arrays
    assert arrays["primal"].tolist() == [[BLACK], [BLACK], [7], [8], [9], [BLACK]]
    assert arrays["dual"].tolist() == [[BLACK], [BLACK], [17], [18], [19], [BLACK]]
    assert arrays["primal"].dtype == arrays["dual"].dtype == np.int32
    assert arrays["head"].shape == (HEAD_SIZE,) and arrays["head"].dtype == np.int64
    assert arrays["head"][Head.FIRST] == 2
    assert arrays["log"].shape == (COUNT, LOG_COLUMNS)
    assert sorted(arrays) == ["dual", "head", "log", "primal"]
    assert log[:, 0].tolist() == [2, 3, 4, 5] and log.dtype == np.int64
    arrays["log"][:] = 0
    assert log[3, 0] == 5  # a copy
    assert process.pictures == [] and set(made.looks_s) == {0.05}


@pytest.mark.parametrize(
    ("stalls_from", "first", "stalls"), [(None, 2, False), (0, 2, True), (5, -3, True)]
)
def test_stalls_are_counted_from_the_refresh_that_was_asked_for(
    bench: Bench, process: DisplayProcess, stalls_from: int | None, first: int, stalls: bool
) -> None:
    made = Pass(bench, process)
    made.play(stalls_from=stalls_from)
    assert made.arrays["head"][Head.FIRST] == first
    assert (made.message.stalls, made.message.abort) == (stalls, False)


def test_progress_is_that_of_the_rows_asked_for(bench: Bench, process: DisplayProcess) -> None:
    made = Pass(bench, process)
    made.steps = [(n, n // 4, 0.1) for n in range(COUNT + 1)]
    made.play()
    assert made.told == [(0, 0), (0, 0), (0, 0), (1, 0), (2, 1), (3, 1), (3, 1)]


def test_the_pictures_of_a_pass_are_of_the_rows_asked_for(bench: Bench) -> None:
    process = bench.started(grab_px=((0, 0), (8, 0)))
    bench.heard()
    made = Pass(bench, process)
    made.play()
    assert [found.shape for found in process.pictures] == [(3, 6, 8), (3, 6, 8)]
    for found in process.pictures:
        assert found[:, 0, 0].tolist() == [2, 3, 4]


def test_who_cancels_is_heard_once_and_told_when_it_is_black(
    bench: Bench, process: DisplayProcess
) -> None:
    made = Pass(bench, process)
    made.cancel_at, made.shown = 2, 4
    made.steps = [(1, 0, 0.1), (2, 0, 0.1), (3, 0, 0.1), (4, 0, 0.1)]
    with pytest.raises(Cancelled, match="cancelled while the codes were shown"):
        made.play()
    assert len(made.told) == 2 and made.arrays["head"][Head.STOP] == 1
    assert "kill" not in bench.process.done


def test_a_pass_that_ended_early_by_itself_is_out_of_step(
    bench: Bench, process: DisplayProcess
) -> None:
    made = Pass(bench, process)
    made.shown = COUNT - 1
    with pytest.raises(SyncError, match=r"more than one refresh \(see what keeps"):
        made.play(abort=True)
    assert "kill" not in bench.process.done


@pytest.mark.parametrize(("waits_s", "hung"), [(HANG_S, False), (HANG_S + 0.25, True)])
def test_a_pass_that_shows_nothing_new_for_too_long_is_ended(
    bench: Bench, process: DisplayProcess, waits_s: float, hung: bool
) -> None:
    made = Pass(bench, process)
    made.steps = [(1, 0, 1.0), (2, 0, 2.0), (2, 0, 0.5), (2, 0, waits_s - 0.5), (3, 0, 0.0)]
    if hung:
        with pytest.raises(DeviceLost, match=r"hung for 3 s and was killed \(see the X server"):
            made.play()
    else:
        made.play()
    assert ("kill" in bench.process.done) == hung


@pytest.mark.parametrize("failure", [ZeroDivisionError(), Cancelled("enough"), DeviceLost("shut")])
@pytest.mark.parametrize("answers", [True, False])
def test_who_fails_at_progress_leaves_black_panels(
    bench: Bench, process: DisplayProcess, answers: bool, failure: Exception
) -> None:
    """Whatever else it raises is not hidden."""
    made = Pass(bench, process)
    made.failure = failure
    made.fail_at, made.silent = 2, not answers
    made.steps = [(1, 0, 0.1), (2, 0, 0.1)]
    with pytest.raises(type(failure)) as caught:
        made.play()
    assert caught.value is failure
    assert made.arrays["head"][Head.STOP] == 1 and len(made.told) == 2
    assert ("kill" in bench.process.done) == (not answers)
    if answers:  # its answer was taken: the next one is that to the next question
        assert not MessageLine.wait(process._line, 0.0)
    else:
        assert bench.clock.now_s == pytest.approx(100.2 + HANG_S, abs=1.0)


def test_a_failure_in_a_pass_is_raised_and_no_stop_is_asked_for(
    bench: Bench, process: DisplayProcess
) -> None:
    made = Pass(bench, process, Failed("device_lost", "an output went", None, True))
    with pytest.raises(DeviceLost, match="an output went"):
        made.play()
    assert made.arrays["head"][Head.STOP] == 0
