"""Threads that read for clients: how many there are, how long they have, and their ends."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from pdcd.errors import BusyError, RequestError
from pdcd.server.readers import Readers
from tests.processes import LONG_S

ANNA = 1


class Disk:
    """One that answers when it is let; `reads` counts what was begun."""

    def __init__(self) -> None:
        self.free = threading.Event()
        self.reads = 0
        self.ended: list[str] = []

    def prepare(self) -> Callable[[Callable[[], None]], str]:
        def read(alive: Callable[[], None]) -> str:
            self.reads += 1
            assert self.free.wait(LONG_S)
            try:
                alive()
            except BaseException as err:
                self.ended.append(type(err).__name__)
                raise
            self.ended.append("read")
            return "read"

        return read


@pytest.fixture
def disk() -> Iterator[Disk]:
    made = Disk()
    yield made
    made.free.set()
    for thread in threading.enumerate():
        if thread.name == "pdcd-reader":
            thread.join(LONG_S)


async def until(done: Callable[[], bool]) -> None:
    async with asyncio.timeout(LONG_S):
        while not done():
            await asyncio.sleep(0.001)


async def test_what_a_read_returns_or_raises_is_the_askers() -> None:
    threads: list[threading.Thread] = []

    def read(alive: Callable[[], None]) -> str:
        alive()
        threads.append(threading.current_thread())
        return "read"

    def fails(alive: Callable[[], None]) -> str:
        raise ZeroDivisionError

    readers = Readers(each=1, total=1)
    for _ in range(3):
        assert await readers.run(ANNA, lambda: read) == "read"
        with pytest.raises(ZeroDivisionError):
            await readers.run(ANNA, lambda: fails)
    assert not readers._turns._held
    assert all(thread.daemon and thread.name == "pdcd-reader" for thread in threads)


async def test_two_threads_for_each_user_and_eight_for_all(disk: Disk) -> None:
    readers = Readers()
    asked = []
    for user in range(4):
        for _ in range(2):
            asked.append(asyncio.create_task(readers.run(user, disk.prepare)))
        third = asyncio.create_task(readers.run(user, disk.prepare))
        await until(lambda: disk.reads == len(asked))
        third.cancel()
        await asyncio.gather(third, return_exceptions=True)
    assert disk.reads == 8
    other = asyncio.create_task(readers.run(99, disk.prepare))
    await asyncio.sleep(0.02)
    assert disk.reads == 8 and not other.done()
    disk.free.set()
    assert await asyncio.gather(*asked, other) == ["read"] * 9


async def test_who_finds_no_thread_or_no_room_in_time_is_told_so(disk: Disk) -> None:
    readers = Readers(each=1, total=2, limit_s=0.0)
    prepared: list[int] = []

    def prepare() -> Any:
        prepared.append(1)
        return disk.prepare()

    with pytest.raises(BusyError, match="too many arrays") as caught:
        await readers.run(ANNA, prepare, lambda: False)
    assert caught.value.hint == "wait until some are answered"
    assert not readers._turns._held and not prepared
    readers._limit_s = LONG_S
    first = asyncio.create_task(readers.run(ANNA, prepare))
    await until(lambda: disk.reads == 1)
    readers._limit_s = 0.0
    with pytest.raises(BusyError):
        await readers.run(ANNA, prepare)
    assert len(prepared) == 1 and readers._turns._held == {ANNA: 1}
    disk.free.set()
    assert await first == "read"


async def test_a_read_that_takes_too_long_is_left_behind_and_told_to_end(disk: Disk) -> None:
    readers = Readers(each=1, total=1, limit_s=0.01)
    with pytest.raises(RequestError, match=r"within 0\.01 s") as caught:
        await readers.run(ANNA, disk.prepare)
    assert caught.value.hint == "give files of a disk that answers"
    await until(lambda: disk.reads == 1)
    assert readers._turns._held == {ANNA: 1}  # until it really ends
    disk.free.set()
    await until(lambda: not readers._turns._held)
    assert disk.ended == ["_Over"]


async def test_a_read_that_cannot_be_prepared_takes_no_thread() -> None:
    def prepare() -> Any:
        raise RequestError("there is no such file")

    readers = Readers(each=1, total=1)
    for _ in range(2):
        with pytest.raises(RequestError, match="no such file"):
            await readers.run(ANNA, prepare)
    assert not readers._turns._held


async def test_a_read_whose_loop_has_ended_ends_in_silence(
    disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    unhandled: list[Any] = []
    monkeypatch.setattr(threading, "excepthook", unhandled.append)

    asked = asyncio.create_task(Readers().run(ANNA, disk.prepare))
    await until(lambda: disk.reads == 1)
    asked.cancel()
    await asyncio.gather(asked, return_exceptions=True)
    disk.free.set()
    for thread in threading.enumerate():
        if thread.name == "pdcd-reader":
            thread.join(LONG_S)
    assert unhandled == [] and disk.ended == ["_Over"]
