"""The driver's side of the display process, against an end of the talk that a test holds."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.errors import ConfigError, DeviceLost, PdcdError, SyncError
from pdcd.presenter.client import DisplayProcess
from pdcd.presenter.memory import attach
from pdcd.presenter.messages import (
    Black,
    Done,
    Failed,
    Load,
    Open,
    Quit,
    Reply,
    Show,
)
from pdcd.presenter.timing import random_codes
from tests.unit.presenter.client_bench import HANG_S, READY, Bench, Child, child_of, silent


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    bench = Bench(monkeypatch)
    yield bench
    bench.close()


@pytest.fixture
def process(bench: Bench) -> DisplayProcess:
    made = bench.started()
    bench.heard()
    return made


# The beginning.


def test_the_process_has_its_end_of_the_talk_and_nothing_of_the_terminal(bench: Bench) -> None:
    number = bench.passed.fileno()
    process = bench.started()
    child = child_of(bench)
    assert child.words == [sys.executable, "-P", "-m", "pdcd.presenter", str(number)]
    assert child.how == {
        "pass_fds": (number,), "start_new_session": True, "stdin": subprocess.DEVNULL,
    }  # fmt: skip
    request, fd = bench.heard()
    assert isinstance(request, Open) and request.options.hang_s == HANG_S and fd is None
    assert process.ready == READY and process.pid == 4711 and process.alive
    assert process.pictures == []
    # Only the process has it now: its end is heard of here.
    assert bench.passed.fileno() == -1
    child.ended = 0
    assert not process.alive


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
    bench: Bench, reply: Reply, error: type[PdcdError]
) -> None:
    with pytest.raises(error) as caught:
        bench.started(reply)
    child = child_of(bench)
    assert child.kills == 1 and None in child.waits and bench.mine.fileno() == -1
    assert caught.value.device == "display"
    if isinstance(reply, Failed):
        assert (caught.value.message, caught.value.hint) == (reply.message, reply.hint)
    else:
        assert "out of step" in caught.value.message


def test_signs_of_life_are_given_while_the_panels_open_for_half_a_minute(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[float] = []

    class Poller:
        def register(self, sock: socket.socket, events: int) -> None: ...

        def poll(self, wait_ms: float) -> list[Any]:
            looks.append(wait_ms)
            bench.now_s += 1.0
            return []

    monkeypatch.setattr("select.poll", Poller)
    with pytest.raises(DeviceLost, match=r"did not answer within 30 s and was killed \(see"):
        bench.started()
    assert len(looks) == bench.pulses == 31 and set(looks) == {50.0}
    assert child_of(bench).kills == 1


# What is asked, and what is answered.


def test_all_patterns_are_handed_over_in_memory_that_is_let_go(
    bench: Bench, process: DisplayProcess
) -> None:
    frames = random_codes((3, 4))
    before = len(list(Path("/proc/self/fd").iterdir()))
    bench.answer(Done())
    process.load(frames)
    message, fd = bench.heard()
    assert isinstance(message, Load) and fd is not None
    arrays = attach(fd, message.slots)
    os.close(fd)
    assert len(list(Path("/proc/self/fd").iterdir())) == before + 1  # the mapping's own
    assert (message.grid, message.lattice, message.window) == ((3, 4), (3, 4), "whole")
    assert sorted(arrays) == [
        "code", "dual_index", "dual_patterns", "guard", "primal_index", "primal_patterns", "shift",
    ]  # fmt: skip
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, getattr(frames, name))


def test_patterns_are_waited_for_no_longer_than_twenty_seconds(
    bench: Bench, process: DisplayProcess
) -> None:
    silent(bench, process)
    with pytest.raises(DeviceLost, match="takes no patterns"):
        process.load(random_codes((3, 4)))
    assert bench.now_s == 100.0 + 20.5 and bench.pulses == 41
    assert child_of(bench).kills == 1


def test_a_row_is_held_once_that_is_answered(bench: Bench, process: DisplayProcess) -> None:
    bench.answer(Done())
    process.show(5)
    assert bench.heard() == (Show(5), None)
    looks_ms = silent(bench, process, 0.01)
    with pytest.raises(DeviceLost, match=r"did not answer within 3\.05 s"):
        process.show(6)
    assert bench.now_s == pytest.approx(103.05, abs=0.02) and set(looks_ms) == {50.0}


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
    assert process.alive is alive and child_of(bench).kills == (not alive)


@pytest.mark.parametrize(
    ("status", "how"), [(-9, "by signal 9"), (3, "with status 3"), (0, "with status 0")]
)
def test_a_process_that_has_gone_is_lost_with_how_it_ended(
    bench: Bench, process: DisplayProcess, status: int, how: str
) -> None:
    child_of(bench).status = status
    bench.theirs.close()
    with pytest.raises(DeviceLost, match=f"the display process ended {how} \\(see the log"):
        process.show(1)
    assert not process.alive and bench.mine.fileno() == -1


def test_what_a_process_said_last_is_the_better_error(
    bench: Bench, process: DisplayProcess
) -> None:
    bench.answer(Failed("config", "an output has changed", None, False))
    bench.theirs.close()
    with pytest.raises(ConfigError, match="an output has changed"):
        process.show(1)
    assert child_of(bench).kills == 1


def test_a_process_that_answered_and_went_is_lost_all_the_same(
    bench: Bench, process: DisplayProcess
) -> None:
    bench.answer(Done())
    bench.theirs.close()
    with pytest.raises(DeviceLost, match="ended by signal 9"):
        process.show(1)


@pytest.mark.parametrize("asked", ["load", "show", "black"])
def test_a_wait_that_a_signal_breaks_off_ends_the_process(
    bench: Bench, process: DisplayProcess, asked: str
) -> None:
    """Its answer would be taken for that to the next request, perhaps for black."""

    def poll(wait_ms: float) -> list[Any]:
        raise KeyboardInterrupt

    process._poller = SimpleNamespace(poll=poll)  # type: ignore[assignment]
    how = {"load": (random_codes((3, 4)),), "show": (1,), "black": ()}
    with pytest.raises(KeyboardInterrupt):
        getattr(process, asked)(*how[asked])
    assert child_of(bench).kills == 1 and not process.alive


# Black, and the end.


def test_black_is_asked_for_and_no_server_where_the_process_answers(
    bench: Bench, process: DisplayProcess
) -> None:
    bench.answer(Done())
    process.black()
    assert bench.heard() == (Black(), None)
    assert bench.connected == [] and child_of(bench).kills == 0


@pytest.mark.parametrize("how", ["refuses", "is silent", "has ended"])
def test_black_is_what_a_process_leaves_that_is_ended_where_there_is_a_screen(
    bench: Bench, process: DisplayProcess, how: str
) -> None:
    if how == "refuses":
        bench.answer(Failed("config", "no", None, True))
    elif how == "is silent":
        silent(bench, process)
    else:
        child_of(bench).ended = 1
    process.black()
    assert child_of(bench).kills == (how != "has ended")
    assert bench.connected == [":7", (":7", "x")]
    assert how != "is silent" or bench.now_s == 100.0 + HANG_S + 0.5


def closing(bench: Bench, process: DisplayProcess) -> Child:
    process.close()
    child = child_of(bench)
    assert child.ended is not None and bench.mine.fileno() == -1
    return child


def test_a_process_is_asked_to_quit_and_waited_for(bench: Bench, process: DisplayProcess) -> None:
    bench.answer(Done())
    child = closing(bench, process)
    assert bench.heard() == (Quit(), None)
    assert (child.kills, child.waits) == (0, [HANG_S, None])
    process.close()
    process.kill()
    assert child.kills == 0


@pytest.mark.parametrize("stubborn", [True, False])
def test_a_process_that_does_not_quit_is_ended(
    bench: Bench, process: DisplayProcess, stubborn: bool
) -> None:
    if stubborn:
        bench.answer(Done())
        child_of(bench).stubborn = True
    else:
        bench.answer(Failed("config", "no", None, True))
    assert closing(bench, process).kills == 1


def test_a_process_that_has_ended_is_asked_nothing(
    bench: Bench, process: DisplayProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    child_of(bench).ended = 0
    asked: list[Callable[..., object]] = []
    monkeypatch.setattr(process, "_ask", lambda *what: asked.append(*what))
    assert closing(bench, process).kills == 0 and asked == []
