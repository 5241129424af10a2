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
from drivers.ptp import shutter as shutter_module
from drivers.ptp.bulb import BULB, REMOTE, Bulb
from drivers.ptp.codes import Operation, ResponseCode
from drivers.ptp.faults import NoAnswer
from drivers.ptp.options import PtpOptions
from drivers.ptp.shutter import PtpShutter
from drivers.ptp.transport import TransactionReply
from pdcd.bench.clock import VirtualClock
from pdcd.child import WORDS, MessageLine
from pdcd.errors import DeviceLost, ExposureError
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
        ([b"arm"], True),
        ([b"arm", b"look"], True),  # a look changes nothing
        ([b"arm", b"disarm"], False),
        ([b"arm", b"disarm", b"look"], False),
        ([b"disarm", b"arm"], True),
        ([b"look"], False),
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
    error: Exception
    done: list[Any]
    now_s: float

    def __init__(self, options: PtpOptions, clock: Any, backend: object, longest_s: float) -> None:
        self.done.append((options, backend, longest_s))

    def open(self, user: str) -> None:
        self.done.append(("open", user))
        Camera.now_s += 1.0
        if Camera.fails:
            Camera.fails -= 1
            raise Camera.error

    def let_go(self, user: str) -> None:
        self.done.append(("let go", user))


@pytest.fixture
def camera(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Camera]]:
    monkeypatch.setattr(guardian, "EosCamera", Camera)
    Camera.fails, Camera.error, Camera.done, Camera.now_s = 0, DeviceLost("held"), [], 100.0

    def sleep(seconds: float) -> None:
        Camera.done.append(("sleep", seconds))

    monkeypatch.setattr(time, "monotonic", lambda: Camera.now_s)
    monkeypatch.setattr(time, "sleep", sleep)
    yield Camera
    monkeypatch.undo()


@pytest.mark.parametrize("fails", [0, 1, 59, 60])
def test_a_camera_that_another_program_holds_is_tried_for_a_minute(
    camera: type[Camera], fails: int, caplog: pytest.LogCaptureFixture
) -> None:
    camera.fails = fails
    with caplog.at_level(logging.WARNING):
        assert guardian.close_shutter(OPTIONS, "usb") is True
    tries = [("open", "guardian"), ("sleep", 0.2)] * fails
    assert camera.done == [
        (OPTIONS, "usb", 60.0), *tries, ("open", "guardian"), ("let go", "guardian"),
    ]  # fmt: skip
    assert "shutter closed in place of" in caplog.text


def test_one_that_is_held_for_longer_is_given_up(
    camera: type[Camera], caplog: pytest.LogCaptureFixture
) -> None:
    camera.fails = 1000
    assert guardian.close_shutter(OPTIONS, None) is False
    assert camera.done.count(("open", "guardian")) == 61
    assert "shutter may be open error=held" in caplog.text
    assert ("let go", "guardian") not in camera.done


def test_a_fault_of_the_program_is_not_tried_again(camera: type[Camera]) -> None:
    camera.fails, camera.error = 1, RuntimeError("a bug")
    with pytest.raises(RuntimeError, match="a bug"):
        guardian.close_shutter(OPTIONS, None)


# Its guard, and the shutter that it closes.


def test_the_guardian_has_time_to_start_and_to_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []

    class Guard:
        def __init__(self, command: tuple[str, ...], **how: Any) -> None:
            made.append((command, how))

        def insist(self, word: str) -> None:
            made.append(word)

    class Eos:
        options = OPTIONS
        bulb = Bulb(
            lambda *_, **__: TransactionReply(0x2001, (), memoryview(b"")), int, VirtualClock()
        )

        def open(self, user: str) -> dict[str, str]:
            return {"serial": "0007"}

        def let_go(self, user: str) -> None: ...

        def cut_short(self, why: str) -> None: ...

    monkeypatch.setattr(shutter_module, "ShutterGuard", Guard)
    camera: Any = Eos()
    config: Any = type("Trigger", (), {"sure_ns": 5})
    shutter = PtpShutter(camera, VirtualClock(), config)
    assert shutter.connect() == {"serial": "0007"}
    (command, how), word = made
    assert command[:-1] == shutter_module.PTP_GUARDIAN
    assert msgspec.json.decode(command[-1], type=PtpOptions) == PtpOptions(serial="0007")
    assert how == {"answer_s": 20.0, "unguarded": camera.cut_short} and word == "disarm"
    assert PtpShutter.maturity == "experimental"


def bulb_of(answers: dict[Operation, Any]) -> tuple[Bulb, list[Operation]]:
    sent: list[Operation] = []

    def order(code: Operation, *params: int, once: bool = False) -> TransactionReply:
        sent.append(code)
        answer = answers.get(code, ResponseCode.OK)
        if isinstance(answer, Exception):
            raise answer
        return TransactionReply(answer, (), memoryview(b""))

    return Bulb(order, lambda: 0, VirtualClock()), sent


def test_a_session_brings_its_own_way_to_release() -> None:
    bulb, sent = bulb_of({})
    bulb.new_session(None)
    assert sent == [] and bulb.method is None
    bulb.new_session(REMOTE)
    bulb.begin()
    assert sent == [REMOTE.stop, REMOTE.start]
    bulb.new_session(BULB)
    assert sent[2:] == [BULB.stop] and bulb.chosen() is BULB
    with pytest.raises(AttributeError):
        BULB.name = "remote"  # type: ignore[misc]


def test_a_fault_of_the_program_while_a_start_is_ended_is_not_hidden() -> None:
    bulb, _ = bulb_of({BULB.start: NoAnswer("x"), BULB.stop: RuntimeError("a bug")})
    bulb.method = BULB
    with pytest.raises(RuntimeError, match="a bug"):
        bulb.begin()
    assert bulb.since_ns is not None  # nobody has heard that it is closed


def test_a_session_that_is_renewed_while_the_shutter_is_closed_has_closed_it() -> None:
    bulb, sent = bulb_of({})
    bulb.method = BULB
    bulb.begin()
    real = bulb._order

    def renewing(code: Operation, *params: int, once: bool = False) -> TransactionReply:
        bulb._order = real
        bulb.new_session(BULB)
        return TransactionReply(ResponseCode.DEVICE_BUSY, (), memoryview(b""))

    bulb._order = renewing
    with pytest.raises(ExposureError, match="connection was lost while the shutter was open"):
        bulb.end()
    assert sent == [BULB.start, BULB.stop] and bulb.since_ns is None
