"""The engine's thread: one call after the other, a sign of life, and its end."""

from __future__ import annotations

import asyncio
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.server.worker import EngineThread
from tests.processes import LONG_S
from tests.unit.server.test_runner import Desk, at_desk


@at_desk
async def test_all_calls_run_in_one_thread_one_after_the_other(desk: Desk) -> None:
    threads, at_work = [], []

    def call(number: int, *, more: str = "") -> tuple[int, str]:
        at_work.append(number)
        threads.append(threading.current_thread())
        threading.Event().wait(0.002)
        assert at_work[-1] == number
        return number, more

    said = await asyncio.gather(*(desk.worker.call(call, n, more="x") for n in range(5)))
    assert list(said) == [(n, "x") for n in range(5)]
    (thread,) = set(threads)
    assert thread is not threading.current_thread() and "pdcd-engine" in thread.name
    with pytest.raises(ZeroDivisionError):
        await desk.worker.call(lambda: 1 // 0)


@at_desk
async def test_an_idle_thread_beats_when_probed_and_a_stuck_one_does_not(desk: Desk) -> None:
    worker, free = desk.worker, threading.Event()
    for count in (1, 2):
        worker.probe()
        await worker.call(lambda: None)
        assert worker.beats == count
    stuck = asyncio.ensure_future(worker.call(free.wait, LONG_S))
    await asyncio.sleep(0)
    for _ in range(5):
        worker.probe()
    await asyncio.sleep(0.01)
    assert worker.beats == 2
    free.set()
    await stuck
    await worker.call(lambda: None)
    assert worker.beats == 3  # probes do not pile up


def test_the_thread_is_closed_after_what_it_was_given() -> None:
    worker, done = EngineThread(), SimpleNamespace(count=0)

    def work() -> None:
        threading.Event().wait(0.02)
        done.count += 1

    async def scene() -> None:
        for _ in range(2):
            calling = asyncio.ensure_future(worker.call(work))
            await asyncio.sleep(0)
        worker.close()
        assert done.count == 2
        await calling

    asyncio.run(scene())


@at_desk
async def test_what_a_call_tells_is_heard_before_it_has_ended_however_short_it_is(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, told = asyncio.get_running_loop(), list[str]()
    submit = desk.worker._pool.submit

    def submit_and_wait(*args: Any) -> Any:
        made = submit(*args)
        made.result()  # the thread is done before the loop asks
        return made

    monkeypatch.setattr(desk.worker._pool, "submit", submit_and_wait)
    await desk.worker.call(loop.call_soon_threadsafe, told.append, "event")
    assert told == ["event"]
