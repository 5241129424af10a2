"""The talk with a guardian: nothing it does, or leaves undone, may hold up the one it guards."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator

import pytest

from drivers import guard as guard_module
from drivers.guard import Guard
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


def guard_of(program: str, answer_s: float = ANSWER_S) -> Guard:
    return Guard(lambda fd: (sys.executable, "-c", program, str(fd)), answer_s=answer_s)


@pytest.fixture
def guard() -> Iterator[Guard]:
    guard = guard_of(ECHO)
    guard.insist("ready")
    yield guard
    guard.stop()


def test_it_answers(guard: Guard) -> None:
    assert guard.ask("open") == b"open"


def test_a_guardian_that_is_stopped_in_its_tracks_is_not_waited_for(
    guard: Guard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And is replaced by one that answers."""
    first = guard.pid
    assert first is not None and guard._talk is not None
    os.kill(first, signal.SIGSTOP)
    guard._talk.settimeout(0.2)
    assert guard.ask("open") == b""
    monkeypatch.setattr(guard_module, "_END_S", 0.2)
    guard.insist("open")
    assert guard.pid != first
    assert ended(first)


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


def test_one_that_ends_is_waited_for(guard: Guard) -> None:
    pid = guard.pid
    assert pid is not None
    guard.stop()
    assert ended(pid)
    guard.stop()
