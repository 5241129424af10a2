"""What a guard passes on, and when its time begins and ends."""

from __future__ import annotations

import asyncio

import pytest

from pdcd.web import guard
from pdcd.web.guard import Guards
from tests.unit.web.test_guard import Inner, Line, come


class Whole(Inner):
    """A protocol that also hears the rest."""

    def eof_received(self) -> bool:
        self.told.append("eof")
        return True

    def pause_writing(self) -> None:
        self.told.append("pause")

    def resume_writing(self) -> None:
        self.told.append("resume")


def test_all_that_a_connection_says_is_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "MOST", 1)

    async def scenario() -> None:
        made: list[Whole] = []

        def make() -> Whole:
            made.append(Whole())
            return made[-1]

        guards = Guards(make)
        _, one = come(guards)
        assert one.eof_received() is True
        one.pause_writing()
        one.resume_writing()
        one.connection_lost(None)
        _, first = come(guards)
        _, other = come(guards)
        assert other.eof_received() is None  # it found no place
        assert [inner.told for inner in made] == [
            ["made", "eof", "pause", "resume", "lost"], ["made"], [],
        ]  # fmt: skip
        first.connection_lost(None)

    asyncio.run(scenario())


def test_a_guard_stands_before_streams_only() -> None:
    with pytest.raises(TypeError):
        Guards(Inner)().connection_made(asyncio.BaseTransport())


def test_the_time_of_a_connection_ends_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "STRANGER_S", 0.0)

    async def scenario() -> None:
        guards = Guards(Inner)
        gone, one = come(guards)
        stays, _ = come(guards)
        one.connection_lost(None)
        await asyncio.wait_for(stays.cut.wait(), 30.0)
        assert not gone.cut.is_set()

    asyncio.run(scenario())


def test_the_key_of_a_connection_that_is_none_of_ours_changes_nothing() -> None:
    async def scenario() -> None:
        guards = Guards(Inner)
        line, one = come(guards)
        guards.known(None, 5.0)
        guards.known(Line(), 5.0)
        assert (guards.strangers, one.stranger) == (1, True)
        guards.known(line, 5.0)
        assert (guards.strangers, one.stranger, len(guards)) == (0, False, 1)
        guards.leave(Line())
        assert len(guards) == 1
        one.connection_lost(None)
        assert len(guards) == 0

    asyncio.run(scenario())


def test_the_last_word_on_time_counts() -> None:
    async def scenario() -> None:
        guards = Guards(Inner)
        line, one = come(guards)
        guards.known(line, 0.0)
        guards.known(line, None)
        other, two = come(guards)
        guards.known(other, 0.0)
        await asyncio.wait_for(other.cut.wait(), 30.0)
        assert not line.cut.is_set()
        for each in (one, two):
            each.connection_lost(None)

    asyncio.run(scenario())
