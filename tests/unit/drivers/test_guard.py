"""The talk with a guardian: nothing it does, or leaves undone, may hold up the one it guards."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers import guard as guard_module
from drivers.guard import ShutterGuard
from pdcd.child import WORDS, LineClosedError
from pdcd.errors import DeviceLost
from tests.child_rig import Process, stand_ins
from tests.places import ROOT
from tests.processes import ended, soon

ANSWER_S = 20.0
"""Longer than any start takes on a busy machine."""

ECHO = """
import socket, sys
talk = socket.socket(fileno=int(sys.argv[1]))
while word := talk.recv(64):
    talk.send(word)
"""


def guard_of(program: str, answer_s: float = ANSWER_S) -> ShutterGuard:
    return ShutterGuard((sys.executable, "-c", program), answer_s=answer_s)


@pytest.fixture
def guard() -> Iterator[ShutterGuard]:
    guard = guard_of(ECHO)
    guard.insist("ready")
    yield guard
    guard.stop()


def test_a_guardian_that_is_stopped_in_its_tracks_is_not_waited_for(guard: ShutterGuard) -> None:
    """And is replaced by one that answers."""
    first = guard.pid
    assert first is not None
    os.kill(first, signal.SIGSTOP)
    assert guard.ask("open", 0.2) == b""
    assert ended(first)
    guard.insist("open")
    assert guard.pid not in (None, first)


def test_a_guardian_is_deaf_to_every_signal_from_its_birth_on(guard: ShutterGuard) -> None:
    """Blocked is what the kernel says: no moment is left in which one could end it."""
    status = Path(f"/proc/{guard.pid}/status").read_text()
    blocked = int(next(line for line in status.splitlines() if line[:6] == "SigBlk")[8:], 16)
    heard = {number for number in signal.valid_signals() if not blocked >> (number - 1) & 1}
    assert heard == {signal.SIGKILL, signal.SIGSTOP}


def test_a_program_that_ends_in_an_exposure_is_not_held_up_by_what_watches_the_guardian() -> None:
    """The line closes only then, and the guardian closes the shutter when it does."""
    program = f"""
import sys
from drivers.guard import ShutterGuard

guard = ShutterGuard((sys.executable, "-c", {ECHO!r}), answer_s={ANSWER_S})
guard.arm(lambda: "arm")
print(guard.pid, flush=True)
"""
    ending = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program],
        stdout=subprocess.PIPE, cwd=ROOT, timeout=ANSWER_S, check=True,
    )  # fmt: skip
    assert soon(lambda: ended(int(ending.stdout)))


# A guardian lost in an exposure.


@pytest.fixture
def armed(guard: ShutterGuard) -> ShutterGuard:
    """Disarmed by its end."""
    guard.arm(lambda: "arm")
    return guard


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_an_armed_guardian_that_is_killed_or_stopped_is_replaced(
    armed: ShutterGuard, number: int, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(2):  # the second one is looked after, too
        first = armed.pid
        assert first is not None
        os.kill(first, number)
        assert soon(lambda: armed.pid not in (None, first))  # noqa: B023
        assert ended(first)
        assert armed.ask("there") == b"there"
    assert "lost in an exposure" in caplog.text


def lookers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "pdcd-guard"]


def test_an_exposure_without_any_guardian_is_ended() -> None:
    reasons: list[str] = []
    guard = ShutterGuard((sys.executable, "-c", ECHO), answer_s=ANSWER_S, unguarded=reasons.append)
    guard.arm(lambda: "arm")
    guard._command = ("/nonexistent",)
    assert guard.pid is not None
    os.kill(guard.pid, signal.SIGKILL)
    assert soon(lambda: bool(reasons))
    assert reasons == [
        "cannot start the process that guards the shutter: No such file or directory"
    ]
    guard.stop()


def test_nobody_looks_after_a_guardian_that_was_disarmed(armed: ShutterGuard) -> None:
    first = armed.pid
    assert first is not None
    assert armed.disarm() == b"disarm"
    os.kill(first, signal.SIGKILL)
    assert ended(first)
    assert soon(lambda: not lookers())
    assert armed.pid == first  # still the one that is dead: the next `arm` replaces it


def test_a_guard_that_is_forgotten_is_not_kept_by_the_one_who_looks() -> None:
    guard = guard_of(ECHO)
    guard.arm(lambda: "arm")
    pid = guard.pid
    assert pid is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # nobody waits for the process
        del guard
        assert ended(pid)  # its line is closed


class Guardians:
    """Those that were started; each says in advance what it answers to whatever it is told."""

    def __init__(self) -> None:
        self.answers: tuple[str, ...] = ("ok",) * 3
        self.started: list[Process] = []

    def start(self, process: Process) -> None:
        self.started.append(process)
        line = process.line(WORDS)
        for answer in self.answers:
            line.send(answer)

    def heard(self, number: int = 0) -> list[bytes]:
        words: list[bytes] = []
        line = self.started[number].lines[0]
        while line.wait(0.0):
            try:
                words.append(line.receive())
            except LineClosedError:
                return [*words, b"(end)"]
        return words


@pytest.fixture
def guardians(monkeypatch: pytest.MonkeyPatch) -> Iterator[Guardians]:
    monkeypatch.setattr(guard_module, "_look_after", lambda *_: None)  # nobody looks by himself
    for children in stand_ins(monkeypatch):
        found = Guardians()
        children.on_start = found.start
        yield found


def made(answer_s: float = 0.01, **how: Any) -> ShutterGuard:
    return ShutterGuard(("guardian",), 7, 8, answer_s=answer_s, **how)


def test_one_that_does_not_answer_is_killed(guardians: Guardians) -> None:
    guardians.answers = ()
    guard = made()
    guard.start()
    assert guard.ask("look") == b""
    assert guardians.started[0].done == ["kill", ("wait", 5.0)]
    assert guardians.heard() == [b"look", b"(end)"]
    assert guard.pid is None
    assert guard.ask("look") == b""
    assert len(guardians.started[0].done) == 2  # it is no more


def test_one_that_does_not_hear_is_replaced_once_and_told_the_same(
    guardians: Guardians, caplog: pytest.LogCaptureFixture
) -> None:
    guardians.answers = ()
    guard = made()
    with pytest.raises(DeviceLost, match="does not start"):
        guard.insist("a")
    assert len(guardians.started) == 1 and guardians.started[0].done[0] == "kill"
    assert "replaced" not in caplog.text
    guard.start()
    guardians.answers = ("ok",)
    guard.insist("b")
    assert [len(guardians.started), guardians.heard(2)] == [3, [b"b"]]
    assert "guardian replaced" in caplog.text
    guard.stop()


def test_a_lost_one_is_replaced_and_armed_and_a_lost_cause_is_told_once(
    guardians: Guardians, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guard_module, "HEARD_S", 0.01)
    ended: list[str] = []
    words = iter(["arm 30", "arm 20", "arm 10"])
    guardians.answers = ("ok",)
    guard = made(unguarded=ended.append)
    guard.arm(lambda: next(words))
    assert guard.look() is True
    assert [guardians.heard(n) for n in range(len(guardians.started))] == [
        [b"arm 30", b"look", b"(end)"],
        [b"arm 20"],
    ]
    assert ended == []
    guardians.answers = ()
    assert guard.look() is False
    assert ended == ["the process that guards the shutter does not start"]
    assert guard.look() is False
    assert (len(ended), len(guardians.started)) == (1, 3)


@pytest.mark.parametrize("later", ["ended", "guarded", "disarmed"])
def test_an_exposure_that_could_not_be_ended_is_looked_after_still(
    guardians: Guardians, monkeypatch: pytest.MonkeyPatch, later: str
) -> None:
    monkeypatch.setattr(guard_module, "HEARD_S", 0.01)
    guardians.answers = ("ok",)
    failures = [DeviceLost("the camera does not answer")] * 2
    ended: list[str] = []

    def unguarded(why: str) -> None:
        ended.append(why)
        if failures:
            raise failures.pop()

    guard = made(unguarded=unguarded)
    guard.arm(lambda: "arm 30")
    guardians.answers = ()
    assert guard.look() is True and guard.look() is True
    assert len(ended) == 2
    if later == "ended":
        assert guard.look() is False and len(ended) == 3
    elif later == "guarded":
        guardians.answers = ("ok",) * 3
        assert guard.look() is True and guard.look() is True
        assert guardians.heard(-1) == [b"arm 30", b"look"]
    else:
        guard.disarm()
    if later != "guarded":
        assert guard.look() is False
    guard.stop()


def test_one_that_is_told_to_end_is_waited_for_and_killed_where_it_stays(
    guardians: Guardians,
) -> None:
    for ends, wait, done in (
        (True, True, [("wait", 5.0)]),
        (False, True, [("wait", 5.0), "kill", ("wait", 5.0)]),
        (False, False, [("wait", 0.0)]),  # nobody waits for it: it is buried later
    ):
        guard = made()
        guard.start()
        process = guardians.started[-1]
        process.returncode = 0 if ends else None
        guard.stop(wait=wait)
        guard.stop()
        assert process.done == done and guardians.heard(-1) == [b"(end)"]
        assert guard.pid is None and guard.ask("open") == b""


def test_an_armed_guardian_is_looked_at_until_it_is_disarmed_or_stopped(
    guardians: Guardians,
) -> None:
    ended: list[str] = []
    guardians.answers = ("ok",) * 4
    guard = made(unguarded=ended.append)
    guard.start()
    assert guard.look() is False  # nobody is armed, and nobody is asked
    guard.arm(lambda: "arm 30")
    assert guard.look() is True
    assert guard.disarm() == b"ok"
    assert guard.look() is False
    assert guardians.heard(0) == [b"arm 30", b"look", b"disarm"]
    guard.arm(lambda: "arm 30")
    guard.stop()
    assert guard.look() is False
    assert (len(guardians.started), ended) == (1, [])
