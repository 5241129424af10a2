"""Present events out of a library that stands in for libxcb: taken, passed over, waited for."""

from __future__ import annotations

import ctypes
import select
import time
from collections.abc import Callable
from typing import Any

import pytest

from pdcd.errors import DeviceLost
from pdcd.presenter import xpresent
from pdcd.presenter.xconnection import ServerLost
from pdcd.presenter.xpresent import KIND_MSC, KIND_PIXMAP, CompleteNotify, PresentEvents

CONNECTION, QUEUE, REPLY = 0x1000, 0x2000, 0x3000


class Server:
    """Both libraries at once. `events` are what is read next; `comes` what a wait brings."""

    def __init__(self) -> None:
        self.said: list[tuple[Any, ...]] = []
        self.events: list[CompleteNotify | None] = []
        self.held: list[CompleteNotify] = []
        self.freed: list[Any] = []
        self.broken = 0
        self.now_ns = 1_000_000_000
        self.waits_ms: list[float] = []
        self.comes: Callable[[], bool] = lambda: False

    def __getattr__(self, name: str) -> Any:
        answers: dict[str, Any] = {
            "xcb_connect": CONNECTION, "xcb_present_query_version": 77,
            "xcb_present_query_version_reply": REPLY, "xcb_generate_id": 555,
            "xcb_register_for_special_xge": QUEUE, "xcb_get_file_descriptor": 8,
        }  # fmt: skip
        if not name.startswith("xcb_"):
            raise AttributeError(name)

        def call(*words: Any) -> Any:
            self.said.append((name, *words))
            return answers.get(name)

        return call

    def xcb_connection_has_error(self, connection: int) -> int:
        assert connection == CONNECTION
        return self.broken

    def xcb_poll_for_special_event(self, connection: int, queue: int) -> int:
        assert (connection, queue) == (CONNECTION, QUEUE)
        if not self.events:
            return 0
        event = self.events.pop(0)
        if event is None:
            return 0
        self.held.append(event)
        return ctypes.addressof(event)

    def free(self, pointer: Any) -> None:
        self.freed.append(pointer)

    # As select.poll().

    def register(self, fd: int, events: int) -> None:
        self.said.append(("poll", fd, events))

    def poll(self, wait_ms: float) -> list[Any]:
        self.waits_ms.append(wait_ms)
        if self.comes():
            return [1]
        self.now_ns += round(wait_ms * 1e6)
        return []

    def names(self) -> list[str]:
        return [words[0] for words in self.said]


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Server:
    made = Server()
    monkeypatch.setattr(xpresent, "_libraries", lambda: (made, made, made))
    monkeypatch.setattr(xpresent, "_Extension", Extension)
    monkeypatch.setattr(select, "poll", lambda: made)
    monkeypatch.setattr(time, "monotonic_ns", lambda: made.now_ns)
    return made


class Extension(ctypes.Structure):
    """What a library has in its data; here, anything of that size."""

    _fields_ = (("name", ctypes.c_char_p), ("global_id", ctypes.c_int))

    @classmethod
    def in_dll(cls, library: Any, name: str) -> Extension:
        assert name == "xcb_present_id"
        return cls()


def event(msc: int, kind: int = KIND_MSC, *, type_: int = 1, mode: int = 0) -> CompleteNotify:
    return CompleteNotify(event_type=type_, kind=kind, mode=mode, ust=1000 + msc, msc=msc)


def test_a_server_that_does_not_answer_is_lost(server: Server) -> None:
    server.broken = 1
    with pytest.raises(ServerLost, match=":7 does not answer: connection refused"):
        PresentEvents(":7", 42)
    assert server.names() == ["xcb_connect"]


def test_a_library_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> Any:
        raise OSError("libxcb-present.so.0: no such file")

    monkeypatch.setattr(xpresent, "_libraries", missing)
    with pytest.raises(DeviceLost, match=r"Present library is missing: libxcb-pr.*libxcb-present0"):
        PresentEvents(":7", 42)

    def strange() -> Any:
        raise AttributeError("undefined symbol")

    monkeypatch.setattr(xpresent, "_libraries", strange)
    with pytest.raises(AttributeError, match="undefined symbol"):  # it is there, and another
        PresentEvents(":7", 42)


@pytest.mark.parametrize(("mode", "flipped"), [(0, 0), (1, 1), (2, 0)])
def test_an_event_that_was_read_before_is_taken_without_waiting(
    server: Server, mode: int, flipped: int
) -> None:
    made = PresentEvents(":7", 42)
    server.events = [event(5, KIND_PIXMAP, mode=mode), event(6, KIND_PIXMAP)]
    del server.freed[:]
    assert made.wait(KIND_PIXMAP, 0.5)
    assert (made.msc, made.ns, made.flipped) == (5, 1_005_000, flipped)
    assert server.waits_ms == [] and server.freed == [ctypes.addressof(server.held[0])]
    assert made.wait(KIND_PIXMAP, 0.5) and made.msc == 6
    server.events = [event(7)]
    assert made.wait(KIND_MSC, 0.5) and server.waits_ms == []  # none was asked for


def test_events_of_other_kinds_are_passed_over_and_let_go(server: Server) -> None:
    made = PresentEvents(":7", 42)
    del server.freed[:]
    server.events = [event(3, KIND_PIXMAP), event(4, KIND_MSC, type_=2), event(5, KIND_MSC)]
    assert made.wait(KIND_MSC, 0.5) and made.msc == 5
    assert server.freed == [ctypes.addressof(held) for held in server.held]
    assert len(server.freed) == 3


def test_an_answer_is_waited_for_before_it_is_looked_for(server: Server) -> None:
    """Once: the next event may have been read with the last."""
    made = PresentEvents(":7", 42)
    server.comes = lambda: True
    for _ in range(2):
        made.ask(4)
        server.events = [event(4)]
        assert made.wait(KIND_MSC, 0.25)
    assert server.waits_ms == [250.0, 250.0]
    server.events = [event(5)]
    assert made.wait(KIND_MSC, 0.25) and len(server.waits_ms) == 2
    made.ask(6)
    server.events = [event(6, KIND_PIXMAP)]
    assert made.wait(KIND_PIXMAP, 0.25) and len(server.waits_ms) == 2


def test_what_does_not_come_is_waited_for_as_long_as_was_asked(server: Server) -> None:
    made = PresentEvents(":7", 42)
    begun_ns = server.now_ns
    assert not made.wait(KIND_MSC, 0.25)
    assert server.now_ns - begun_ns == 250_000_000 and server.waits_ms == [250.0]
    made.ask(4)
    assert not made.wait(KIND_MSC, 0.25)
    assert server.now_ns - begun_ns == 500_000_000 and server.waits_ms == [250.0, 250.0]
    assert (made.msc, made.ns) == (0, 0)


def test_who_is_woken_for_nothing_waits_for_the_rest_of_the_time(server: Server) -> None:
    made = PresentEvents(":7", 42)

    def comes() -> bool:
        server.now_ns += 100_000_000
        return True

    server.comes = comes
    assert not made.wait(KIND_MSC, 0.25)
    assert server.waits_ms == [pytest.approx(ms) for ms in (250.0, 150.0, 50.0)]


def test_a_server_that_goes_wakes_who_waits(server: Server) -> None:
    made = PresentEvents(":7", 42)
    server.broken, server.comes = 1, lambda: True
    with pytest.raises(ServerLost, match="it ended the connection"):
        made.wait(KIND_MSC, 0.25)
    server.comes = lambda: False
    assert not made.wait(KIND_MSC, 0.25)  # nothing woke it: nobody asks whether it is there
