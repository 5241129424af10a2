"""The queue of one client: its bounds, its order, and how it ends."""

from __future__ import annotations

import asyncio
import logging
from typing import cast

import pytest

from pdcd.protocol.views import ClientRole
from pdcd.server import callers
from pdcd.server.access import Peer
from pdcd.server.callers import Caller
from pdcd.server.stream import Stream

ANNA = Peer(11, 1000, 1000, "anna")


class Far:
    """A client that reads while it is `open`; `breaks` is what writing to it raises."""

    def __init__(self) -> None:
        self.lines: list[bytes] = []
        self.is_cut = False
        self.open = asyncio.Event()
        self.breaks: Exception | None = None

    async def send(self, line: bytes, fd: int | None = None) -> None:
        await self.open.wait()
        if self.breaks is not None:
            raise self.breaks
        self.lines.append(line)

    def cut(self) -> None:
        self.is_cut = True


def met(*, reads: bool = True) -> tuple[Far, Caller]:
    far = Far()
    if reads:
        far.open.set()
    return far, Caller(7, ANNA, ClientRole.LOOK, cast(Stream, far))


async def turns() -> None:
    for _ in range(20):
        await asyncio.sleep(0)


async def test_lines_are_written_in_order_until_the_end_is_asked_for() -> None:
    far, caller = met()
    pump = asyncio.create_task(caller.pump())
    await turns()
    assert not pump.done()  # there is nothing as yet
    for line in (b"a", b"b"):
        caller.send(line)
        await turns()
    assert far.lines == [b"a", b"b"] and not pump.done()
    caller.send(b"c")
    caller.finish()
    caller.send(b"too late")
    await asyncio.wait_for(pump, 30.0)
    assert far.lines == [b"a", b"b", b"c"] and not far.is_cut


async def test_256_lines_wait_and_of_more_the_oldest_thinned_one_is_left_out() -> None:
    far, caller = met()
    for number in range(256):
        caller.send(b"%d" % number, droppable=number in (3, 5))
    caller.send(b"thinned", droppable=True)  # which is no news that another must go for
    caller.send(b"first more")
    caller.send(b"second more")
    assert not far.is_cut
    caller.finish()
    await caller.pump()
    wanted = [b"%d" % n for n in range(256) if n not in (3, 5)]
    assert far.lines == [*wanted, b"first more", b"second more"]


async def test_who_does_not_take_what_must_be_said_is_parted_from(
    caplog: pytest.LogCaptureFixture,
) -> None:
    far, caller = met()
    for _ in range(256):
        caller.send(b"kept")
    assert not far.is_cut and not caplog.records
    caller.send(b"one more")
    assert far.is_cut
    await caller.pump()
    assert far.lines == []
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert "connection=7" in record.getMessage() and "its queue is full" in record.getMessage()


async def test_there_is_room_when_half_the_queue_is_free() -> None:
    far, caller = met(reads=False)
    for _ in range(128):
        caller.send(b"x")
    await asyncio.wait_for(caller.room(), 30.0)
    caller.send(b"x")
    waiting = asyncio.create_task(caller.room())
    await turns()
    assert not waiting.done()
    far.open.set()
    pump = asyncio.create_task(caller.pump())
    await asyncio.wait_for(waiting, 30.0)
    caller.finish()
    await pump
    assert len(far.lines) == 129


async def test_nobody_waits_for_room_with_a_client_that_is_gone() -> None:
    _, caller = met(reads=False)
    for _ in range(200):
        caller.send(b"x")
    waiting = asyncio.create_task(caller.room())
    await turns()
    caller.abort("it is gone")
    await asyncio.wait_for(waiting, 30.0)


async def test_a_client_that_is_stuck_is_cut_off(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(callers, "STUCK_S", 0.0)

    far, caller = met(reads=False)
    caller.send(b"x")
    caller.send(b"y")
    await asyncio.wait_for(caller.pump(), 30.0)
    assert far.is_cut and far.lines == []
    assert "it has not read for 0 s" in caplog.text


async def test_a_client_that_has_left_is_nothing_to_remark_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    far, caller = met()
    far.breaks = BrokenPipeError()
    caller.send(b"x")
    await asyncio.wait_for(caller.pump(), 30.0)
    assert far.is_cut
    far, other = met()
    far.breaks = ZeroDivisionError()
    other.send(b"x")
    with pytest.raises(ZeroDivisionError):
        await other.pump()
    assert not far.is_cut
    assert not caplog.records
