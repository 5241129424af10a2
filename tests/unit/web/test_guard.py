"""Places and time of connections, without any."""

from __future__ import annotations

import asyncio

import pytest

from pdcd.web import guard
from pdcd.web.guard import Guard, Guards


class Line(asyncio.Transport):
    """A connection that notes whether it was cut."""

    def __init__(self) -> None:
        super().__init__()
        self.cut = asyncio.Event()

    def abort(self) -> None:
        self.cut.set()


class Inner(asyncio.Protocol):
    """A protocol that notes what it is told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.told.append("made")

    def data_received(self, data: bytes) -> None:
        self.told.append(data.decode())

    def connection_lost(self, exc: Exception | None) -> None:
        self.told.append("lost")


def come(guards: Guards) -> tuple[Line, Guard]:
    line, one = Line(), guards()
    one.connection_made(line)
    return line, one


def test_strangers_have_few_places_and_guests_all() -> None:
    async def scenario() -> None:
        guards = Guards(Inner)
        strangers = [come(guards) for _ in range(guard.STRANGERS)]
        assert not any(line.cut.is_set() for line, _ in strangers)
        assert come(guards)[0].cut.is_set()
        for line, _ in strangers:
            guards.known(line, None)
        assert guards.strangers == 0
        more = [come(guards) for _ in range(guard.MOST - guard.STRANGERS)]
        assert not any(line.cut.is_set() for line, _ in more)
        assert len(guards) == guard.MOST
        for line, _ in more:
            guards.known(line, None)
        assert come(guards)[0].cut.is_set()
        strangers[0][1].connection_lost(None)
        last, one = come(guards)
        assert not last.cut.is_set()
        for _, each in (*strangers[1:], *more):
            each.connection_lost(None)
        one.connection_lost(None)
        assert len(guards) == 0

    asyncio.run(scenario())


def test_who_found_no_place_reaches_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        monkeypatch.setattr(guard, "MOST", 1)
        made: list[Inner] = []

        def make() -> Inner:
            made.append(Inner())
            return made[-1]

        guards = Guards(make)
        _, first = come(guards)
        _, second = come(guards)
        for one in (first, second):
            one.data_received(b"hello")
            one.connection_lost(None)
        assert [inner.told for inner in made] == [["made", "hello", "lost"], []]

    asyncio.run(scenario())


def test_the_key_gives_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        monkeypatch.setattr(guard, "STRANGER_S", 0.01)
        guards = Guards(Inner)
        slow, _ = come(guards)
        known, _ = come(guards)
        long, one = come(guards)
        guards.known(known, 0.02)
        guards.known(long, None)
        await asyncio.wait_for(slow.cut.wait(), 10.0)
        await asyncio.wait_for(known.cut.wait(), 10.0)
        assert not long.cut.is_set()
        guards.end()
        assert long.cut.is_set()
        one.connection_lost(None)

    asyncio.run(scenario())
