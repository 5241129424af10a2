"""The talk with a guardian that stands in this process: bounds, order, and what is left behind."""

from __future__ import annotations

import os
import socket
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from drivers import guard as guard_module
from drivers.guard import Guard
from pdcd.errors import DeviceLost


class Process:
    """Stands in for `subprocess.Popen`; `heard` tells what its end of the talk has got."""

    started: list[Process]
    answers: tuple[bytes, ...] = ()
    """What each one says in advance to whatever it is told."""

    def __init__(self, command: list[str], *, pass_fds: tuple[int, ...], **how: Any) -> None:
        self.command, self.inherits = command, pass_fds
        self.how = how
        self.talk = socket.socket(fileno=os.dup(pass_fds[-1]))
        self.talk.setblocking(False)
        self.pid = 100 + len(self.started)
        self.done: list[object] = []
        self.slow = False
        for answer in self.answers:
            self.talk.send(answer)
        self.started.append(self)

    def heard(self) -> list[bytes]:
        words: list[bytes] = []
        try:
            while word := self.talk.recv(64):
                words.append(word)
        except BlockingIOError:
            return words
        except ConnectionResetError:  # the end, with an answer unread
            pass
        return [*words, b"(end)"]

    def wait(self, timeout: float | None = None) -> int:
        self.done.append(("wait", timeout))
        if self.slow and timeout is not None:
            raise subprocess.TimeoutExpired("guardian", timeout)
        return 0

    def kill(self) -> None:
        self.done.append(("kill", self.heard()))


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Process]]:
    """Those that were started; each says three times ok."""
    monkeypatch.setattr(Process, "started", [], raising=False)
    monkeypatch.setattr(Process, "answers", (b"ok",) * 3)
    monkeypatch.setattr(subprocess, "Popen", Process)
    monkeypatch.setattr(guard_module, "_look_after", lambda *_: None)  # nobody looks by himself
    yield Process.started
    for process in Process.started:
        process.talk.close()


def made(answer_s: float = 0.01, **how: Any) -> Guard:
    return Guard(lambda fd: ["guardian", str(fd)], 7, 8, answer_s=answer_s, **how)


def test_a_lost_guardian_is_noticed_within_four_tenths_of_a_second() -> None:
    assert guard_module.LOOK_S <= 0.1
    assert guard_module.HEARD_S <= 0.3


def test_a_guardian_gets_what_it_inherits_and_its_end_of_the_talk(
    processes: list[Process],
) -> None:
    guard = made()
    assert guard.pid is None
    guard.start()
    (process,) = processes
    assert guard.pid == process.pid
    assert process.inherits[:2] == (7, 8)
    assert process.command == ["guardian", str(process.inherits[2])]
    nothing = subprocess.DEVNULL
    assert process.how == {"stdin": nothing, "stdout": nothing, "start_new_session": True}
    guard.stop()


def test_the_bound_of_an_answer_is_that_of_the_class_unless_another_is_given(
    processes: list[Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    bounds: list[float | None] = []
    real = socket.socket.settimeout

    def settimeout(talk: socket.socket, bound: float | None) -> None:
        bounds.append(bound)
        real(talk, bound)

    monkeypatch.setattr(socket.socket, "settimeout", settimeout)
    guard = made(answer_s=3.5)
    guard.start()
    assert [guard.ask("a"), guard.ask("b", 0.25), guard.ask("c", 0.0)] == [b"ok"] * 3
    assert bounds == [3.5, 0.25, 0.0]
    guard.stop()


def test_one_that_does_not_answer_is_killed_before_it_hears_the_end(
    processes: list[Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would take the end for its cue to close the shutter, perhaps in a later exposure."""
    monkeypatch.setattr(Process, "answers", ())
    guard = made()
    guard.start()
    assert guard.ask("look") == b""
    assert processes[0].done == [("kill", [b"look"]), ("wait", None)]
    assert processes[0].heard() == [b"(end)"]
    assert guard.pid is None
    assert guard.ask("look") == b""
    assert len(processes[0].done) == 2  # it is no more


def test_one_whose_end_is_closed_has_no_answer(processes: list[Process]) -> None:
    guard = made()
    guard.start()
    processes[0].talk.shutdown(socket.SHUT_RDWR)
    for _ in range(3):
        processes[0].heard()
    assert [guard.ask("look") for _ in range(4)][-1] == b""
    assert guard.pid is None


def test_one_that_ends_in_time_is_told_to_and_waited_for(processes: list[Process]) -> None:
    guard = made()
    guard.start()
    guard.stop()
    assert processes[0].done == [("wait", 5.0)]
    assert processes[0].heard() == [b"(end)"]
    guard.stop()
    assert len(processes[0].done) == 1
    assert guard.pid is None


def test_one_that_does_not_end_is_killed_and_waited_for(processes: list[Process]) -> None:
    guard = made()
    guard.start()
    processes[0].slow = True
    guard.stop()
    assert processes[0].done == [("wait", 5.0), ("kill", [b"(end)"]), ("wait", None)]


def test_one_that_nobody_waits_for_is_told_to_end_and_remembered(
    processes: list[Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    at_work: list[Any] = []
    monkeypatch.setattr(guard_module, "_at_work", at_work)
    guard = made()
    guard.start()
    guard.stop(wait=False)
    assert processes[0].done == []
    assert processes[0].heard() == [b"(end)"]
    assert at_work == processes
    assert guard.pid is None


def test_one_that_hears_is_not_replaced(processes: list[Process]) -> None:
    guard = made()
    guard.start()
    guard.insist("a")
    guard.insist("b")
    assert len(processes) == 1
    assert processes[0].heard() == [b"a", b"b"]
    guard.stop()


def test_one_that_does_not_hear_is_replaced_once_and_told_the_same(
    processes: list[Process], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(Process, "answers", ())
    guard = made()
    with pytest.raises(DeviceLost, match="does not start"):
        guard.insist("a")
    assert len(processes) == 1 and processes[0].done[0] == ("kill", [b"a"])
    assert "replaced" not in caplog.text
    guard.start()
    monkeypatch.setattr(Process, "answers", (b"ok",))
    guard.insist("b")
    assert [len(processes), processes[2].heard()] == [3, [b"b"]]
    assert "guardian replaced" in caplog.text
    guard.stop()


def test_an_armed_guardian_is_looked_at_until_it_is_disarmed(processes: list[Process]) -> None:
    guard = made()
    guard.start()
    assert guard.look() is False  # nobody is armed, and nobody is asked
    guard.arm(lambda: "arm 30")
    assert guard.look() is True
    assert guard.disarm() == b"ok"
    assert guard.look() is False
    assert processes[0].heard() == [b"arm 30", b"look", b"disarm"]
    guard.stop()


def test_a_stopped_guardian_is_armed_no_more(processes: list[Process]) -> None:
    ended: list[str] = []
    guard = made(unguarded=ended.append)
    guard.start()
    guard.arm(lambda: "arm 30")
    guard.stop()
    assert guard.look() is False
    assert (len(processes), ended) == (1, [])


def test_a_lost_one_is_replaced_and_armed_and_a_lost_cause_is_told_once(
    processes: list[Process], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guard_module, "HEARD_S", 0.01)
    ended: list[str] = []
    words = iter(["arm 30", "arm 20", "arm 10"])
    monkeypatch.setattr(Process, "answers", (b"ok",))
    guard = made(unguarded=ended.append)
    guard.arm(lambda: next(words))
    assert guard.look() is True
    assert [process.heard() for process in processes] == [[b"(end)"], [b"arm 20"]]
    assert ended == []
    monkeypatch.setattr(Process, "answers", ())
    assert guard.look() is False
    assert ended == ["the process that guards the shutter does not start"]
    assert guard.look() is False
    assert (len(ended), len(processes)) == (1, 3)


@pytest.mark.parametrize("later", ["ended", "guarded", "disarmed"])
def test_an_exposure_that_could_not_be_ended_is_looked_after_still(
    processes: list[Process], monkeypatch: pytest.MonkeyPatch, later: str
) -> None:
    monkeypatch.setattr(guard_module, "HEARD_S", 0.01)
    monkeypatch.setattr(Process, "answers", (b"ok",))
    failures = [DeviceLost("the camera does not answer")] * 2
    ended: list[str] = []

    def unguarded(why: str) -> None:
        ended.append(why)
        if failures:
            raise failures.pop()

    guard = made(unguarded=unguarded)
    guard.arm(lambda: "arm 30")
    monkeypatch.setattr(Process, "answers", ())
    assert guard.look() is True and guard.look() is True
    assert len(ended) == 2
    if later == "ended":
        assert guard.look() is False and len(ended) == 3
    elif later == "guarded":
        monkeypatch.setattr(Process, "answers", (b"ok",) * 3)
        assert guard.look() is True and guard.look() is True
        assert processes[-1].heard() == [b"arm 30", b"look"]
    else:
        guard.disarm()
    if later != "guarded":
        assert guard.look() is False
    guard.stop()
