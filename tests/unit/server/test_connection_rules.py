"""Who finds a place, who hears an event, and how requests are answered: without a socket."""

from __future__ import annotations

import asyncio
import errno
import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import pytest

from pdcd.bench.tables import LimitsConfig
from pdcd.errors import DeniedError
from pdcd.protocol import events
from pdcd.protocol.messages import MAX_LINE, NoParams, ShowReply
from pdcd.protocol.request import CaptureRequest
from pdcd.server.access import Access
from pdcd.server.callers import Caller
from pdcd.server.connections import Server
from pdcd.server.jobs import Job, JobTable, Owner
from pdcd.server.protocol import RpcRequest
from pdcd.server.reading import answer_request

ANNA, OWN = 1001, 900


@contextmanager
def serving(**limits: Any) -> Iterator[Server]:
    with socket.socket(socket.AF_UNIX) as sock:
        access = Access({}, {}, frozenset({0, OWN}))
        yield Server(sock, access, LimitsConfig(**limits))


class Line:
    """What one client is sent."""

    def __init__(self, number: int, interest: Any) -> None:
        self.number, self.interest = number, interest
        self.got: list[tuple[dict[str, Any], bool]] = []

    def send(self, line: bytes, *, droppable: bool = False, fd: int | None = None) -> None:
        self.got.append((json.loads(line), droppable))


def job(connection: int) -> Job:
    owner = Owner(uid=ANNA, pid=1, user="anna", connection=connection)
    return JobTable().admit(CaptureRequest(goal="white"), {}, owner, detach=False, queue=False)


def test_an_event_that_is_too_long_for_a_line_ends_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with serving() as server:
        line = Line(1, "all")
        callers: dict[int, Any] = {1: line}
        server._callers = callers
        server.publish(job(1), events.Attention(job="j", text="x" * MAX_LINE))
        assert line.got == [] and "event not sent" in caplog.text
        server.publish(job(1), events.Attention(job="j", text="x"))
        assert len(line.got) == 1


class Service:
    """Answers, or raises."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    async def handle(self, caller: Any, request: RpcRequest) -> Any:
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer


class Held:
    """Notes which descriptors are given back."""

    def __init__(self) -> None:
        self.released: list[tuple[int, ...]] = []

    def release(self, fds: tuple[int, ...]) -> None:
        self.released.append(fds)


class UntoldError(Exception):
    def __str__(self) -> str:
        raise ValueError


SHOWN = ShowReply("grid", 0, "j")
OURS = "a fault of the program: see the log"
SCARCE = "try again in a moment; if it stays, raise LimitNOFILE or give it more memory"


@pytest.mark.parametrize(
    ("answer", "told", "logged"),
    [
        (SHOWN, {"pattern": "grid", "index": 0, "job": "j"}, ""),
        (DeniedError("no", hint="ask"), ("denied", "no", "ask"), ""),
        (ZeroDivisionError("by nothing"),
         ("internal", "ZeroDivisionError: by nothing", OURS), "method failed"),
        (SystemExit("now"), ("internal", "SystemExit: now", OURS), "method failed"),
        (OSError(errno.EMFILE, "too many"),
         ("busy", "the system has nothing left: too many", SCARCE), "method failed"),
        (OSError(errno.EIO, "of a device"),
         ("internal", f"OSError: [Errno {errno.EIO}] of a device", OURS), "method failed"),
        (UntoldError(), ("internal", "UntoldError: it has no text", OURS), "method failed"),
        (MemoryError(), ("busy", "the system has nothing left: out of memory", SCARCE),
         "method failed"),
        (FileNotFoundError(errno.ENOENT, "gone", "a/b"),
         ("disk", "cannot use 'a/b': gone", "check folder and rights"), "method failed"),
        (DeniedError("x" * MAX_LINE, hint="ask"), ("denied", "x" * 8000 + "...", "ask"), ""),
        (ShowReply("\udce9", 0, "j"), {"pattern": "\\udce9", "index": 0, "job": "j"}, ""),
        (ShowReply("x" * MAX_LINE, 0, "j"),
         ("protocol", None, "read it from the run folder instead"), ""),
    ],
)  # fmt: skip
def test_every_request_is_answered_once_and_gives_back_what_came_with_it(
    answer: Any, told: Any, logged: str, caplog: pytest.LogCaptureFixture
) -> None:
    line, held = Line(1, "none"), Held()
    for request_id in (5, None):
        request = RpcRequest(request_id, "display.show", NoParams(), (7, 8))
        body = answer_request(
            cast(Any, Service(answer)), cast(Caller, line), request, cast(Any, held)
        )
        asyncio.run(body)
    assert held.released == [(7, 8)] * 2
    ((message, droppable),) = line.got  # none for a notification
    assert message["id"] == 5 and not droppable
    if isinstance(told, dict):
        assert message["result"] == told
    else:
        error = message["error"]
        assert (error["data"]["kind"], error["data"]["hint"]) == (told[0], told[2])
        assert told[1] in (None, error["message"])
    assert caplog.text.count("method failed") == 2 * bool(logged)
