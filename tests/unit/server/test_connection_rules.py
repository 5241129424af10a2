"""Who finds a place, who hears an event, and how requests are answered: without a socket."""

from __future__ import annotations

import asyncio
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
from pdcd.server import connections as module
from pdcd.server.access import Access, Peer
from pdcd.server.callers import Caller
from pdcd.server.connections import Server
from pdcd.server.jobs import Job, JobTable, Owner
from pdcd.server.protocol import RpcRequest

ANNA, BERT, OWN = 1001, 1002, 900


@contextmanager
def serving(**limits: Any) -> Iterator[Server]:
    with socket.socket(socket.AF_UNIX) as sock:
        access = Access({}, {}, frozenset({0, OWN}))
        yield Server(sock, access, LimitsConfig(**limits))


def place(server: Server, uid: int) -> str:
    """Why there is none, "" where there is one."""
    error = server._full(Peer(1, uid, uid, "x"))
    return "" if error is None else error.message


def test_a_user_has_so_many_places_and_all_users_together() -> None:
    with serving(connections=5, connections_per_user=3) as server:
        server._places[ANNA] = 2
        assert place(server, ANNA) == ""
        server._places[ANNA] = 3
        assert place(server, ANNA) == f"3 clients of uid {ANNA} are connected already"
        server._places[BERT] = 1
        assert place(server, BERT) == ""
        server._places[BERT] = 2
        assert place(server, BERT) == "5 clients are connected already"
        assert place(server, 1003) == "5 clients are connected already"


def test_four_places_each_are_kept_for_root_and_our_own_user() -> None:
    with serving(connections=5, connections_per_user=3) as server:
        server._places[ANNA], server._places[BERT] = 3, 2
        for uid in (0, OWN):
            for held in range(4):
                server._places[uid] = held
                assert place(server, uid) == ""
            server._places[uid] = 4
            assert place(server, uid) == "5 clients are connected already"
        # Theirs are taken from nobody, beyond these they count as any.
        server._places[BERT] = 1
        assert place(server, 0) == place(server, OWN) == place(server, 1003) == ""
        server._places[OWN] = 5
        assert place(server, 1003) == place(server, OWN) == "5 clients are connected already"


class Line:
    """What one client is sent."""

    def __init__(self, number: int, interest: Any) -> None:
        self.number, self.interest = number, interest
        self.got: list[tuple[dict[str, Any], bool]] = []

    def send(self, line: bytes, *, droppable: bool = False) -> None:
        self.got.append((json.loads(line), droppable))


def job(connection: int) -> Job:
    owner = Owner(uid=ANNA, pid=1, user="anna", connection=connection)
    return JobTable().admit(CaptureRequest(goal="white"), {}, owner, detach=False, queue=False)


def test_an_event_is_heard_by_those_who_asked_for_it() -> None:
    with serving() as server:
        lines = [Line(1, "own"), Line(2, "own"), Line(3, "all"), Line(1, "none")]
        callers: dict[int, Any] = dict(enumerate(lines))
        server._callers = callers
        assert server.connections == 4
        mine = job(connection=1)
        server.publish(mine, events.ShotArmed(job="j", shot="s", frames=9))
        server.publish(mine, events.Progress(job="j", shot="s", frame=1, frames=9, missed=0))
    assert [len(line.got) for line in lines] == [2, 0, 2, 0]
    told = [(message["params"]["type"], droppable) for message, droppable in lines[0].got]
    assert told == [("armed", False), ("progress", True)]
    assert {message["method"] for message, _ in lines[0].got} == {"event"}


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


SHOWN = ShowReply("grid", 0, "j")


@pytest.mark.parametrize(
    ("answer", "told", "logged"),
    [
        (SHOWN, {"pattern": "grid", "index": 0, "job": "j"}, ""),
        (DeniedError("no", hint="ask"), ("denied", "no", "ask"), ""),
        (ZeroDivisionError("by nothing"),
         ("internal", "ZeroDivisionError: by nothing", "see the daemon's log"), "method failed"),
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
        body = module._answer(
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


def test_one_who_asks_too_much_at_a_time_is_told_so() -> None:
    line = Line(1, "none")
    for request_id in ("a", None):
        module._refuse_more(cast(Caller, line), RpcRequest(request_id, "ping", NoParams()))
    ((message, _),) = line.got
    assert (message["id"], message["error"]["data"]["kind"]) == ("a", "busy")
    assert message["error"]["message"] == "64 requests of this connection are unanswered"


class Far:
    """Takes a line, or does not."""

    def __init__(self, error: Exception | None = None, *, stuck: bool = False) -> None:
        self.error, self.stuck = error, stuck
        self.got: list[bytes] = []

    async def send(self, line: bytes) -> None:
        if self.error is not None:
            raise self.error
        if self.stuck:
            await asyncio.Event().wait()
        self.got.append(line)


def test_who_may_not_come_in_is_told_why_if_it_waits_for_that(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    peer = Peer(1, ANNA, ANNA, "anna")

    def refused(far: Far) -> None:
        asyncio.run(module._refuse(cast(Any, far), 1, peer, module._stranger(peer)))

    far = Far()
    refused(far)
    error = json.loads(far.got[0])["error"]
    assert error["message"] == f"uid {ANNA} may not use this rig"
    assert error["data"]["kind"] == "denied" and "[server] allow_uids" in error["data"]["hint"]
    assert json.loads(far.got[0])["id"] is None
    refused(Far(BrokenPipeError()))
    monkeypatch.setattr(module, "LINGER_S", 0.0)
    refused(Far(stuck=True))
    with pytest.raises(ZeroDivisionError):
        refused(Far(ZeroDivisionError()))


class Listener:
    """A socket of which clients come, or what accepting raises."""

    def __init__(self, *comes: Any) -> None:
        self.comes = list(comes)
        self.accepted = 0
        self.number = 5

    def accept(self) -> tuple[Any, str]:
        if not self.comes:
            raise BlockingIOError
        found = self.comes.pop(0)
        if isinstance(found, Exception):
            raise found
        self.accepted += 1
        return found, ""

    def setblocking(self, flag: bool) -> None:
        assert not flag

    def fileno(self) -> int:
        return self.number


class Loop:
    """The part of an event loop that watches a socket."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        loop = asyncio.get_running_loop()
        self.calls: list[Any] = []
        patch.setattr(loop, "add_reader", lambda s, call, *told: self.calls.append("add"))
        patch.setattr(loop, "remove_reader", lambda s: self.calls.append("remove"))
        patch.setattr(loop, "call_later", self.later)

    def later(self, delay: float, call: Any, *told: Any) -> None:
        self.calls.append(delay)
        call(*told)


@pytest.mark.parametrize(
    ("comes", "accepted", "calls"),
    [
        ([1] * 20, 16, []),
        ([1, 1], 2, []),
        ([1, InterruptedError(), 1], 1, []),
        ([ConnectionAbortedError(), 1], 0, []),
        ([1, OSError(24, "too many open files"), 1], 1, ["remove", 1.0, "add"]),
    ],
)
def test_clients_are_accepted_some_at_a_time_and_later_where_nothing_is_left(
    comes: list[Any], accepted: int, calls: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    served: list[Any] = []

    async def scenario() -> None:
        listener: Any = Listener(*comes)
        server = Server(listener, Access({}, {}), LimitsConfig())

        async def serve(service: Any, sock: Any) -> None:
            served.append((service, sock))

        monkeypatch.setattr(server, "_serve", serve)
        service: Any = "service"
        with monkeypatch.context() as patch:
            loop = Loop(patch)
            server._accept(service)
            assert loop.calls == calls and len(server._tasks) == accepted
            listener.number = -1  # closed meanwhile: nothing to be opened again
            server._accept_again(service)
            assert loop.calls == calls
        await asyncio.gather(*server._tasks)
        await asyncio.sleep(0)
        assert not server._tasks

    asyncio.run(scenario())
    assert served == [("service", 1)] * accepted


def test_who_wants_nothing_for_the_whole_time_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []

    async def scenario() -> None:
        with serving(idle_s=8.0) as server:
            line: Any = Line(1, "none")
            line.idle_s = 0.0
            wants: list[int] = []

            class Host:
                def engaged(self, caller: Any) -> bool:
                    return len(slept) == 3

            async def sleep(seconds: float) -> None:
                slept.append(seconds)
                wants[:] = [1] * (len(slept) == 1)
                line.interest = "own" if len(slept) == 2 else "none"

            with monkeypatch.context() as patch:
                patch.setattr(asyncio, "sleep", sleep)
                await server._idle(cast(Any, Host()), line, cast(Any, wants))
            ((message, _),) = line.got
            assert message["id"] is None
            assert message["error"]["message"] == "this connection asked for nothing for 8 s"

    asyncio.run(scenario())
    # Three steps in which it wanted something, in one way or another; then one beyond the time.
    assert slept == [1.0] * (3 + 9)
