"""The camera's guardian by itself: what it answers, and how long it tries to close the shutter."""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from drivers.ptp import guardian
from drivers.ptp.options import PtpOptions
from pdcd.child import WORDS, MessageLine
from pdcd.errors import DeviceLost
from tests.processes import LONG_S

OPTIONS = PtpOptions(serial="0001")


@pytest.fixture
def closed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """With what the shutter was closed; it can be, each time."""
    found: list[Any] = []

    def close(options: PtpOptions, backend: object) -> bool:
        found.append((options, backend))
        return True

    monkeypatch.setattr(guardian, "close_shutter", close)
    return found


def talk(words: list[bytes], *, read: bool = True) -> tuple[list[bytes], bool]:
    """What it answers to words, and what it says at the end of the talk."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours, theirs = (MessageLine(end, WORDS) for end in ends)
    said: list[bool] = []
    thread = threading.Thread(
        target=lambda: said.append(guardian.serve_guardian(theirs, OPTIONS, "usb"))
    )
    thread.start()
    answers = []
    for word in words:
        ours.send(word.decode())
        if read:
            answers.append(ours.receive(within_s=LONG_S))
    ours.close()
    thread.join(LONG_S)
    theirs.close()
    return answers, said[0]


@pytest.mark.parametrize(
    ("words", "closes"),
    [
        ([], False),
        ([b"arm", b"look"], True),  # a look changes nothing
        ([b"arm", b"disarm", b"look"], False),
        ([b"disarm", b"arm"], True),
    ],
)
def test_it_closes_the_shutter_if_it_is_armed_at_the_end(
    closed: list[Any], words: list[bytes], closes: bool
) -> None:
    answers, shut = talk(words)
    assert answers == [b"ok"] * len(words) and shut
    assert closed == ([(OPTIONS, "usb")] if closes else [])


def test_a_parent_that_died_with_an_answer_unread_is_gone(closed: list[Any]) -> None:
    _, shut = talk([b"arm", b"look"], read=False)
    assert shut and len(closed) == 1


@pytest.mark.parametrize("shut", [True, False])
def test_its_exit_status_says_whether_the_shutter_is_closed(
    monkeypatch: pytest.MonkeyPatch, shut: bool
) -> None:
    given: list[Any] = []

    def serve(line: object, *what: Any) -> bool:
        given.extend(what)
        return shut

    monkeypatch.setattr(guardian, "serve_guardian", serve)
    ours, theirs = socket.socketpair()
    text = msgspec.json.encode(OPTIONS).decode()
    assert guardian.run_ptp_guardian(text, theirs.detach(), "usb") == (0 if shut else 1)
    ours.close()
    assert given == [OPTIONS, "usb"]


class Camera:
    """One that opens at the so many-th try; a second passes with each."""

    fails: int
    done: list[Any]
    now_s: float

    def __init__(self, options: PtpOptions, clock: Any, backend: object, longest_s: float) -> None:
        self.done.append((options, backend, longest_s))

    def open(self, user: str) -> None:
        self.done.append(("open", user))
        Camera.now_s += 1.0
        if Camera.fails:
            Camera.fails -= 1
            raise DeviceLost("held")

    def let_go(self, user: str) -> None:
        self.done.append(("let go", user))


@pytest.fixture
def camera(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Camera]]:
    monkeypatch.setattr(guardian, "EosCamera", Camera)
    Camera.fails, Camera.done, Camera.now_s = 0, [], 100.0
    monkeypatch.setattr(time, "monotonic", lambda: Camera.now_s)
    monkeypatch.setattr(time, "sleep", lambda seconds: Camera.done.append(("sleep", seconds)))
    yield Camera
    monkeypatch.undo()


@pytest.mark.parametrize("fails", [0, 1, 60, 1000])
def test_a_camera_that_another_program_holds_is_tried_for_a_minute(
    camera: type[Camera], fails: int, caplog: pytest.LogCaptureFixture
) -> None:
    camera.fails = fails
    with caplog.at_level(logging.WARNING):
        assert guardian.close_shutter(OPTIONS, "usb") is (fails <= 60)
    if fails > 60:
        assert camera.done.count(("open", "guardian")) == 61
        assert "shutter may be open error=held" in caplog.text
        assert ("let go", "guardian") not in camera.done
        return
    tries = [("open", "guardian"), ("sleep", 0.2)] * fails
    assert camera.done == [
        (OPTIONS, "usb", 60.0), *tries, ("open", "guardian"), ("let go", "guardian"),
    ]  # fmt: skip
    assert "shutter closed in place of" in caplog.text
