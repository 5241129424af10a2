"""The driver's side of the display process, against an end of the talk that a test holds."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from pdcd.errors import Cancelled, ConfigError, DeviceLost, PdcdError, SyncError
from pdcd.presenter.client import DisplayProcess
from pdcd.presenter.messages import (
    Black,
    DisplayReply,
    Done,
    Failed,
    Load,
    Open,
    Quit,
    Show,
    map_shared_arrays,
)
from pdcd.presenter.timing import make_random_codes
from tests.unit.presenter.client_bench import HANG_S, READY, Bench

# The beginning.


def test_the_process_is_told_what_to_open_and_says_that_it_is_ready(bench: Bench) -> None:
    process = bench.started()
    assert bench.process.command[:-1] == [sys.executable, "-P", "-m", "pdcd.presenter"]
    request, fd = bench.heard()
    assert isinstance(request, Open) and request.options.hang_s == HANG_S and fd is None
    assert process.ready == READY and process.pid == bench.process.pid and process.alive
    assert process.pictures == []
    bench.process.returncode = 0
    assert not process.alive
    process.kill()


def test_a_process_that_cannot_be_had_is_a_lost_display(bench: Bench) -> None:
    bench.children.refusal = OSError(11, "Resource temporarily unavailable")
    with pytest.raises(DeviceLost, match="cannot start the display process: Resource") as caught:
        bench.started()
    assert caught.value.device == "display"


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (Done(), DeviceLost),
        (Failed("config", "no such output", "h", False), ConfigError),
        (Failed("config", "no such output", "h", True), ConfigError),
        (Failed("device_lost", "gone", None, False), DeviceLost),
    ],
)
def test_a_process_that_does_not_get_ready_is_ended(
    bench: Bench, reply: DisplayReply, error: type[PdcdError]
) -> None:
    with pytest.raises(error) as caught:
        bench.started(reply)
    assert bench.process.done[0] == "kill" and ("wait", 5.0) in bench.process.done
    assert caught.value.device == "display"
    if isinstance(reply, Failed):
        assert (caught.value.message, caught.value.hint) == (reply.message, reply.hint)
    else:
        assert "out of step" in caught.value.message


def killed(bench: Bench) -> bool:
    return "kill" in bench.process.done


# What is asked, and what is answered.


def test_all_patterns_are_handed_over_in_memory_that_is_let_go(
    bench: Bench, process: DisplayProcess
) -> None:
    frames = make_random_codes((3, 4))
    before = len(list(Path("/proc/self/fd").iterdir()))
    bench.answer(Done())
    process.load(frames)
    message, fd = bench.heard()
    assert isinstance(message, Load) and fd is not None
    arrays = map_shared_arrays(fd, message.slots)
    os.close(fd)
    assert len(list(Path("/proc/self/fd").iterdir())) == before + 1  # the mapping's own
    assert (message.grid, message.lattice, message.window) == ((3, 4), (3, 4), "whole")
    assert sorted(arrays) == [
        "code", "dual_index", "dual_patterns", "guard", "primal_index", "primal_patterns", "shift",
    ]  # fmt: skip
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, getattr(frames, name))


def test_a_row_is_held_once_that_is_answered(bench: Bench, process: DisplayProcess) -> None:
    bench.answer(Done())
    process.show(5)
    assert bench.heard() == (Show(5), None)


@pytest.mark.parametrize(
    ("kind", "error"),
    [("config", ConfigError), ("device_lost", DeviceLost), ("sync", SyncError), ("?", DeviceLost)],
)
@pytest.mark.parametrize("alive", [True, False])
def test_a_failure_is_raised_as_what_it_was_and_may_be_no_end(
    bench: Bench, process: DisplayProcess, kind: str, error: type[PdcdError], alive: bool
) -> None:
    bench.answer(Failed(kind, "so it is", "do that", alive))
    with pytest.raises(error, match=r"so it is \(do that\)") as caught:
        process.show(1)
    assert type(caught.value) is error and caught.value.device == "display"
    assert process.alive is alive and killed(bench) == (not alive)


@pytest.mark.parametrize(
    ("status", "how"),
    [
        (-9, r"was ended by signal 9 \(SIGKILL\)"), (3, "ended with status 3"),
        (None, "closed its end"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("answers", [True, False])
def test_a_process_that_has_gone_is_lost_with_how_it_ended(
    bench: Bench, process: DisplayProcess, status: int | None, how: str, answers: bool
) -> None:
    if answers:  # to what it was not asked
        bench.answer(Done())
    bench.process.die(status)
    with pytest.raises(DeviceLost, match=f"the display process {how} \\(see the log"):
        process.show(1)
    assert not process.alive and process._line.fileno() == -1


def test_what_a_process_said_last_is_the_better_error(
    bench: Bench, process: DisplayProcess
) -> None:
    bench.answer(Failed("config", "an output has changed", None, False))
    bench.process.die(None)
    with pytest.raises(ConfigError, match="an output has changed"):
        process.show(1)
    assert killed(bench)


@pytest.mark.parametrize("asked", ["load", "show", "black"])
def test_a_wait_that_a_signal_breaks_off_ends_the_process(
    bench: Bench, process: DisplayProcess, asked: str
) -> None:
    """Its answer would be taken for that to the next request, perhaps for black."""

    def alive() -> None:
        raise KeyboardInterrupt

    process._pulse = alive
    how = {"load": (make_random_codes((3, 4)),), "show": (1,), "black": ()}
    with pytest.raises(KeyboardInterrupt):
        getattr(process, asked)(*how[asked])
    assert killed(bench) and not process.alive


# Black, and the end.


def test_black_is_asked_for_and_no_server_where_the_process_answers(
    bench: Bench, process: DisplayProcess
) -> None:
    bench.answer(Done())
    process.black()
    assert bench.heard() == (Black(), None)
    assert bench.connected == [] and not killed(bench)


@pytest.mark.parametrize("how", ["refuses", "is silent", "has ended"])
def test_black_is_what_a_process_leaves_that_is_ended_where_there_is_a_screen(
    bench: Bench, process: DisplayProcess, how: str
) -> None:
    if how == "refuses":
        bench.answer(Failed("config", "no", None, True))
    elif how == "is silent":
        bench.clock.silence(0.5)
    else:
        bench.process.returncode = 1
    process.black()
    assert killed(bench) == (how != "has ended")
    assert bench.connected == [":7", (":7", "x")]
    assert how != "is silent" or bench.clock.now_s == 100.0 + HANG_S


def test_a_process_is_asked_to_quit_and_waited_for(bench: Bench, process: DisplayProcess) -> None:
    bench.answer(Done())
    waits = bench.process.wait

    def quits(timeout: float | None = None) -> int:
        bench.process.returncode = 0
        return waits(timeout)

    bench.process.wait = quits  # type: ignore[method-assign]
    for end in (process.close, process.close, process.kill):
        end()
    assert bench.heard() == (Quit(), None) and process._line.fileno() == -1
    assert bench.process.done[0] == ("wait", HANG_S) and not killed(bench)


@pytest.mark.parametrize(("asked", "bound_s"), [("open", 30.0), ("load", 20.0), ("show", 3.05)])
def test_each_answer_has_its_bound_and_is_waited_for_with_signs_of_life(
    bench: Bench, asked: str, bound_s: float
) -> None:
    process = bench.started() if asked != "open" else None
    looks_s = bench.clock.silence(0.05)
    pulses = bench.pulses
    with pytest.raises(DeviceLost, match=rf"did not answer within {bound_s:g} s and was killed"):
        if process is None:
            bench.started()
        elif asked == "load":
            process.load(make_random_codes((3, 4)))
        else:
            process.show(6)
    assert bench.clock.now_s == pytest.approx(100.0 + bound_s, abs=0.06) and killed(bench)
    assert bench.pulses - pulses >= bound_s / 0.05 - 2
    assert max(s for s in looks_s if s is not None) == 0.05


@pytest.mark.parametrize("answer", [None, Done(), Failed("config", "no", None, True)])
def test_a_process_that_does_not_quit_is_ended_and_one_that_has_is_asked_nothing(
    bench: Bench,
    process: DisplayProcess,
    monkeypatch: pytest.MonkeyPatch,
    answer: DisplayReply | None,
) -> None:
    asked: list[Any] = []
    if answer is None:
        bench.process.returncode = 0
        monkeypatch.setattr(process, "_ask", lambda *what: asked.append(what))
    else:
        bench.answer(answer)
    process.close()
    assert bench.process.returncode is not None and process._line.fileno() == -1
    assert bench.process.done.count("kill") == (answer is not None) and asked == []


def test_a_start_is_broken_off_by_who_waits_no_longer(bench: Bench) -> None:
    """The process that is killed then takes its windows along."""
    bench.first = ()
    cancel = Mock(side_effect=Cancelled("enough"))
    with pytest.raises(Cancelled):
        bench.started_by(cancel)
    assert bench.pulses == 0 and bench.process.returncode is not None
