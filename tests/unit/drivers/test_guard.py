"""The talk with a guardian: nothing it does, or leaves undone, may hold up the one it guards."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers import guard as guard_module
from drivers.guard import ShutterGuard
from pdcd.errors import DeviceLost
from tests.processes import ended

ANSWER_S = 20.0
"""Longer than any start takes on a busy machine."""

ECHO = """
import socket, sys
talk = socket.socket(fileno=int(sys.argv[1]))
while word := talk.recv(64):
    talk.send(word)
"""
SILENT = """
import socket, sys
talk = socket.socket(fileno=int(sys.argv[1]))
while talk.recv(64):
    pass
"""
STUBBORN = ECHO + "import time\ntime.sleep(600)\n"


def guard_of(program: str, answer_s: float = ANSWER_S) -> ShutterGuard:
    return ShutterGuard((sys.executable, "-c", program), answer_s=answer_s)


@pytest.fixture
def guard() -> Iterator[ShutterGuard]:
    guard = guard_of(ECHO)
    guard.insist("ready")
    yield guard
    guard.stop()


def test_it_answers(guard: ShutterGuard) -> None:
    assert guard.ask("open") == b"open"


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


def test_only_a_guardian_that_had_another_before_it_is_called_a_replacement(
    caplog: pytest.LogCaptureFixture,
) -> None:
    guard = guard_of(ECHO)
    guard.insist("ready")
    assert "replaced" not in caplog.text
    assert guard.pid is not None
    os.kill(guard.pid, signal.SIGKILL)
    guard.insist("ready")
    assert caplog.text.count("guardian replaced") == 1
    guard.stop()


# A guardian lost in an exposure.


@pytest.fixture
def armed(guard: ShutterGuard) -> ShutterGuard:
    """Disarmed by its end."""
    guard.arm(lambda: "arm")
    return guard


def soon(true: Callable[[], bool]) -> bool:
    until_s = time.monotonic() + ANSWER_S
    while not true() and time.monotonic() < until_s:
        time.sleep(0.005)
    return true()


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


def test_one_thread_at_a_time_looks_and_it_keeps_no_process_alive(armed: ShutterGuard) -> None:
    for _ in range(2):
        armed.arm(lambda: "arm")
    assert soon(lambda: len(lookers()) == 1)
    time.sleep(guard_module.GUARD_LOOK_S)
    (looker,) = lookers()
    assert looker.daemon and armed.look()
    armed.stop()
    assert soon(lambda: not lookers()) and not armed.look()


def test_a_lost_guardian_is_noticed_within_half_a_second(armed: ShutterGuard) -> None:
    """By the bounds themselves: a busy machine makes a measured time say nothing."""
    assert guard_module.GUARD_LOOK_S + guard_module.HEARD_S <= 0.5
    asked = []
    armed.ask = lambda word, answer_s=None: asked.append((word, answer_s)) or b"ok"  # type: ignore[func-returns-value, method-assign]
    assert soon(lambda: len(asked) > 1)
    assert set(asked) == {("look", guard_module.HEARD_S)}


def test_one_that_replaces_another_is_armed_for_what_is_left(armed: ShutterGuard) -> None:
    words = iter(["arm 30", "arm 20"])
    armed.arm(lambda: next(words))
    armed.ask = lambda word, answer_s=None: b"" if word == "look" else said.append(word) or b"ok"  # type: ignore[func-returns-value, method-assign]
    said: list[str] = []
    assert soon(lambda: bool(said))
    assert said[0] == "arm 20"


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


def test_answers_have_their_bound() -> None:
    guard = guard_of(SILENT, answer_s=0.5)
    began_s = time.monotonic()
    with pytest.raises(DeviceLost, match="guards the shutter does not start"):
        guard.insist("ready")
    assert time.monotonic() - began_s < 30.0
    guard.stop()


def test_one_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard_module, "_END_S", 0.3)
    guard = guard_of(STUBBORN)
    guard.insist("ready")
    pid = guard.pid
    assert pid is not None
    guard.stop()
    assert ended(pid)
    assert guard.pid is None and guard.ask("open") == b""


def test_one_that_ends_is_waited_for(guard: ShutterGuard) -> None:
    pid = guard.pid
    assert pid is not None
    guard.stop()
    assert ended(pid)
    guard.stop()
