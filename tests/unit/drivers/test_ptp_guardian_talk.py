"""A camera's guardian by itself: what it answers, when it ends its parent, and how long it tries to
close the shutter."""

from __future__ import annotations

import logging
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import Any

import msgspec
import pytest

from drivers import guarding
from drivers.ptp import guardian
from drivers.ptp.options import PtpOptions
from pdcd.child import WORDS, MessageLine
from pdcd.errors import DeviceLost
from tests.processes import LONG_S, soon

OPTIONS = PtpOptions(serial="0001")


class Talk:
    """Words to a guardian in a thread; `closed` and `killed` count what it did."""

    def __init__(self) -> None:
        ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.ours, self.theirs = (MessageLine(end, WORDS) for end in ends)
        self.closed = self.killed = 0
        self.said: list[bool] = []
        self.thread = threading.Thread(target=self._serve)
        self.thread.start()

    def _serve(self) -> None:
        self.said.append(guarding.serve_guardian(self.theirs, self._close, self._kill))

    def _close(self) -> None:
        self.closed += 1

    def _kill(self) -> None:
        self.killed += 1
        self.ours.close()

    def say(self, words: list[bytes], *, read: bool = True) -> list[bytes]:
        answers = []
        for word in words:
            self.ours.send(word.decode())
            if read:
                answers.append(self.ours.receive(within_s=LONG_S))
        return answers

    def end(self) -> bool:
        """The end of the talk, and whether the shutter is closed then."""
        self.ours.close()
        self.thread.join(LONG_S)
        self.theirs.close()
        return self.said[0]


@pytest.mark.parametrize(
    ("words", "closes"),
    [
        ([], 0),
        ([b"arm", b"look"], 1),  # a look changes nothing
        ([b"arm", b"disarm", b"look"], 0),
        ([b"disarm", b"arm"], 1),
    ],
)
def test_it_closes_the_shutter_if_it_is_armed_at_the_end(words: list[bytes], closes: int) -> None:
    talk = Talk()
    assert talk.say(words) == [b"ok"] * len(words) and talk.end()
    assert (talk.closed, talk.killed) == (closes, 0)


def test_a_parent_that_died_with_an_answer_unread_is_gone() -> None:
    talk = Talk()
    talk.say([b"arm", b"look"], read=False)
    assert talk.end() and talk.closed == 1


def test_a_parent_that_says_nothing_while_the_shutter_is_open_is_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only then: it may be silent for days while nothing is open."""
    monkeypatch.setattr(guarding, "FROZEN_S", 0.2)
    talk = Talk()
    talk.say([b"arm", b"disarm"])
    time.sleep(0.5)
    assert talk.killed == 0
    talk.say([b"arm"])
    talk.thread.join(LONG_S)
    assert (talk.killed, talk.closed, talk.end()) == (1, 1, True)


@pytest.mark.parametrize("shut", [True, False])
def test_its_exit_status_says_whether_the_shutter_is_closed(
    monkeypatch: pytest.MonkeyPatch, shut: bool
) -> None:
    given: list[Any] = []
    monkeypatch.setattr(guarding, "serve_guardian", lambda line, close, end: [close(), shut][1])
    monkeypatch.setattr(guardian, "close_eos", lambda *what: given.append(what))
    ours, theirs = socket.socketpair()
    text = msgspec.json.encode(OPTIONS).decode()
    assert guardian.run_ptp_guardian(text, theirs.detach(), "usb") == (0 if shut else 1)
    ours.close()
    assert given == [(OPTIONS, "usb")]


PARENT = """
import os, signal, sys
from drivers.guard import ShutterGuard
from drivers import guarding

guard = ShutterGuard((sys.executable, "-c", sys.argv[1], sys.argv[2]), answer_s=60.0)
guard.arm(lambda: "arm")
os.kill(os.getpid(), signal.SIGSTOP)
"""
CHILD = """
import sys
from pathlib import Path
from drivers import guarding

guarding.FROZEN_S = 0.5
sys.exit(guarding.run_camera_guardian(int(sys.argv[2]), Path(sys.argv[1]).touch))
"""


def test_a_frozen_process_is_killed_and_its_shutter_closed(tmp_path: Any) -> None:
    """Nobody else would do it without systemd's watchdog."""
    closed = tmp_path / "closed"
    with subprocess.Popen([sys.executable, "-c", PARENT, CHILD, str(closed)]) as parent:
        try:
            assert parent.wait(LONG_S) == -signal.SIGKILL
        finally:
            parent.kill()
    assert soon(closed.exists)


@pytest.mark.parametrize("fails", [0, 1, 60, 1000])
def test_a_camera_that_another_program_holds_is_tried_for_a_minute(
    monkeypatch: pytest.MonkeyPatch, fails: int, caplog: pytest.LogCaptureFixture
) -> None:
    """Each try takes a second."""
    now_s, tries = 100.0, 0
    slept: list[float] = []

    def close() -> None:
        nonlocal now_s, tries
        now_s, tries = now_s + 1.0, tries + 1
        if tries <= fails:
            raise DeviceLost("held")

    with monkeypatch.context() as patch, caplog.at_level(logging.WARNING):
        patch.setattr(time, "monotonic", lambda: now_s)
        patch.setattr(time, "sleep", slept.append)
        closed = guarding.try_to_close(close)
    assert closed is (fails <= 60) and tries == min(fails, 60) + 1
    assert slept == [0.2] * min(fails, 60)
    words = "shutter closed in place of" if closed else "shutter may be open error=held"
    assert words in caplog.text
