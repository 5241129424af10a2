"""Calls made aside: what they return or raise, and what is left of those that nobody waits for."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import threading
import weakref
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from pdcd.errors import BusyError
from pdcd.server.aside import call_in_thread
from pdcd.server.readers import Readers
from tests.processes import LONG_S


class Odd(BaseException):
    """An error that is no `Exception`."""


async def test_a_call_is_made_in_a_thread_of_its_own_which_is_gone_afterwards() -> None:
    threads: list[threading.Thread] = []

    def call(*told: int, **more: str) -> Any:
        threads.append(threading.current_thread())
        return told, more

    assert await call_in_thread(call, 1, 2, more="x") == ((1, 2), {"more": "x"})
    assert await call_in_thread(call) == ((), {})
    assert len(set(threads)) == 2 and threading.main_thread() not in threads
    for thread in threads:
        assert not thread.is_alive() and thread.daemon and thread.name == "pdcd-aside"


@pytest.mark.parametrize("error", [ZeroDivisionError("x"), RuntimeError("y"), UnicodeError("z")])
async def test_whatever_it_raises_belongs_to_the_caller(error: BaseException) -> None:
    def call() -> None:
        raise error

    with pytest.raises(type(error)) as caught:
        await call_in_thread(call)
    assert caught.value is error


@pytest.mark.parametrize("error", [Odd(), SystemExit(), StopIteration(), asyncio.CancelledError()])
async def test_what_would_end_more_than_the_caller_is_a_fault_of_the_call(
    error: BaseException,
) -> None:
    def call() -> None:
        raise error

    with pytest.raises(RuntimeError) as caught:
        await call_in_thread(call)
    assert caught.value.__cause__ is error


def left_behind(call: Callable[[], object], *, ends_first: bool) -> list[Any]:
    """What goes wrong where the caller, or its whole loop, is gone before the call ends."""
    free, began, faults = threading.Event(), threading.Event(), []
    threads: list[threading.Thread] = []

    def held() -> object:
        threads.append(threading.current_thread())
        began.set()
        assert free.wait(LONG_S)
        return call()

    async def scenario() -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, told: faults.append(told))
        caller = asyncio.create_task(call_in_thread(held))
        await asyncio.to_thread(began.wait, LONG_S)
        caller.cancel()
        with pytest.raises(asyncio.CancelledError):
            await caller  # at once: it does not wait for the thread
        assert threads[0].is_alive()
        if not ends_first:
            free.set()
            await asyncio.to_thread(threads[0].join, LONG_S)
            for _ in range(3):
                await asyncio.sleep(0)

    asyncio.run(scenario())
    free.set()
    threads[0].join(LONG_S)
    assert not threads[0].is_alive()
    return faults


@pytest.mark.parametrize("ends_first", [False, True])
def test_who_waits_no_longer_hears_nothing(
    ends_first: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    unhandled: list[Any] = []
    monkeypatch.setattr(threading, "excepthook", unhandled.append)

    def fails() -> None:
        raise ZeroDivisionError

    for call in (lambda: 5, fails):
        assert left_behind(call, ends_first=ends_first) == []
    assert unhandled == []


class Held:
    """Something that a frame knows of when an error is raised."""


async def read_aside(function: Callable[[], object]) -> object:
    return await Readers().run(1, lambda: lambda alive: function())


@pytest.mark.parametrize("call", [call_in_thread, read_aside])
async def test_an_error_keeps_nothing_once_it_was_dealt_with(
    call: Callable[[Callable[[], object]], Awaitable[object]],
) -> None:
    """A request of a megabyte would else be kept until the next search for circles."""
    held: list[weakref.ref[Held]] = []

    def refuse() -> None:
        large = Held()
        held.append(weakref.ref(large))
        raise BusyError("no")

    gc.disable()
    try:
        with contextlib.suppress(BusyError):
            await call(refuse)
        async with asyncio.timeout(LONG_S):
            while held[0]() is not None:  # its thread has a step to go
                await asyncio.sleep(0.001)
    finally:
        gc.enable()
