"""The thread that listens to the daemon: it subscribes, tells what it hears, and comes back."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncGenerator, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from pdcd.errors import BusyError
from pdcd.protocol import events
from pdcd.protocol.line_talk import UnreachableError
from pdcd.web import news as module
from pdcd.web.asks import DaemonQueries
from pdcd.web.news import News

PATIENCE_S = 30.0


class Idle(DaemonQueries):
    """A daemon whose state is always the same."""

    def __init__(self) -> None:
        super().__init__(Path("/nowhere"))

    async def ask(self, method: str, params: object = None, **unused: object) -> Any:
        return {"state": "idle"}


class Daemons:
    """What the listener meets, one visit after the other; the last one stays until it is closed."""

    def __init__(self, *visits: Exception | list[events.Event]) -> None:
        self.visits = list(visits)
        self.made: list[tuple[Path, float]] = []
        self.calls: list[tuple[str, Any]] = []
        self.closed = threading.Event()
        self.left = 0

    def client(self, socket: Path, timeout_s: float) -> Any:
        self.made.append((socket, timeout_s))
        visit = self.visits.pop(0)
        if isinstance(visit, Exception):
            raise visit
        return Visit(self, visit, last=not self.visits)


class Visit:
    """One connection; a context manager, as the client is."""

    def __init__(self, daemons: Daemons, told: list[events.Event], *, last: bool) -> None:
        self.daemons, self.told, self.last = daemons, told, last

    def __enter__(self) -> Visit:
        return self

    def __exit__(self, *_: object) -> None:
        self.daemons.left += 1

    def call(self, method: str, params: Any) -> None:
        self.daemons.calls.append((method, params))

    def events(self, jobs: str) -> Iterator[events.Event]:
        self.daemons.calls.append(("events", jobs))
        yield from self.told
        if self.last:
            assert self.daemons.closed.wait(PATIENCE_S)

    def close(self) -> None:
        self.daemons.closed.set()


class Pauses(threading.Event):
    """An end that is asked for, and the pauses that were made until then."""

    def __init__(self) -> None:
        super().__init__()
        self.pauses: list[float | None] = []

    def wait(self, timeout: float | None = None) -> bool:
        self.pauses.append(timeout)
        return self.is_set()


async def until(page: AsyncGenerator[bytes, None], wanted: Callable[[Any], bool]) -> list[Any]:
    """What a page is told up to what is wanted."""
    told: list[Any] = []
    while not told or not wanted(told[-1]):
        data = await asyncio.wait_for(anext(page), PATIENCE_S)
        told.append(json.loads(data.removeprefix(b"data: ")))
    return told


async def test_the_listener_comes_back_and_tells_why_it_was_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    queued, armed = (
        events.JobQueued(job="a", ahead=0),
        events.ShotArmed(job="b", shot="s", frames=9),
    )
    daemons = Daemons(
        UnreachableError("nobody answers"), BusyError("it is full"), [queued], [armed]
    )
    monkeypatch.setattr(module, "Client", daemons.client)

    told = News(Path("/there"), Idle())
    ended = told._ended = Pauses()
    page = told.page()
    first = await until(page, lambda message: True)
    assert (first[0]["here"], first[0]["why"], first[0]["visit"]) == (
        False,
        "not reached yet",
        0,
    )
    told.start()
    heard = await until(page, lambda message: message.get("job") == "b")
    whys = [message["why"] for message in heard if message.get("here") is False]
    assert whys == ["nobody answers", "it is full", "the daemon went away"]
    assert [message["job"] for message in heard if message["what"] == "event"] == ["a", "b"]
    assert told._visit == 2
    await told.close()
    assert not told._thread.is_alive() and daemons.closed.is_set()
    with pytest.raises(StopAsyncIteration):
        while True:
            await asyncio.wait_for(anext(page), PATIENCE_S)
    assert ended.pauses[:3] == [1.0] * 3
    assert daemons.made == [(Path("/there"), 5.0)] * 4 and daemons.left == 2
    assert daemons.calls == [("events.subscribe", {"jobs": "all"}), ("events", "all")] * 2


async def test_who_reaches_the_daemon_after_the_end_asks_it_for_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    daemons = Daemons([events.JobQueued(job="a", ahead=0)])

    told = News(Path("/there"), Idle())

    def client(socket: Path, timeout_s: float) -> Any:
        told._ended.set()  # while the daemon greeted
        return daemons.client(socket, timeout_s)

    monkeypatch.setattr(module, "Client", client)
    told._listen()
    assert daemons.calls == [] and daemons.left == 1 and told._client is None
    await told.close()
