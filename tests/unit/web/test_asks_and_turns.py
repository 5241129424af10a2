"""Questions to the daemon, and the places that they take."""

from __future__ import annotations

import asyncio
import gc
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pdcd.errors import BusyError
from pdcd.web import asks as module
from pdcd.web.asks import DaemonQueries, Turns

PATIENCE_S = 30.0


class Held:
    """Calls that last until they are let go; `began` counts them."""

    def __init__(self) -> None:
        self.free = threading.Event()
        self.began = 0

    def call(self, *told: Any) -> Any:
        self.began += 1
        assert self.free.wait(PATIENCE_S)
        return told


async def until(done: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not done():
            await asyncio.sleep(0.001)


async def test_a_question_goes_over_a_connection_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[Any] = []

    class Client:
        def __init__(self, socket: Path, timeout_s: float) -> None:
            told.append((socket, timeout_s))

        def __enter__(self) -> Client:
            return self

        def __exit__(self, *_: object) -> None:
            told.append("closed")

        def call(self, method: str, params: Any, *, timeout_s: float) -> str:
            told.append((method, params, timeout_s))
            return f"answer to {method}"

    monkeypatch.setattr(module, "Client", Client)

    asks = DaemonQueries(Path("/there"))
    assert await asks.ask("rig.status") == "answer to rig.status"
    assert await asks.ask("capture.plan", {"a": 1}, answer_s=7.0) == "answer to capture.plan"
    assert await asks.cancel("j") == "answer to capture.cancel"
    there = (Path("/there"), 5.0)
    assert told == [
        there, ("rig.status", None, 10.0), "closed",
        there, ("capture.plan", {"a": 1}, 7.0), "closed",
        there, ("capture.cancel", {"job": "j"}, 60.0), "closed",
    ]  # fmt: skip


async def test_three_questions_at_a_time_and_one_more_to_cancel(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "WAIT_S", 0.0)

    # A place that is free is had without any wait, so that a wait of no time finds it.
    held, asks = Held(), DaemonQueries(Path("/there"))
    monkeypatch.setattr(asks, "_call", held.call)
    asked = [asyncio.create_task(asks.ask("plan", answer_s=n)) for n in range(3)]
    await until(lambda: held.began == 3)
    with pytest.raises(BusyError, match="too much is asked of the daemon at a time") as caught:
        await asks.ask("plan")
    assert caught.value.hint == "try again in a moment"
    asked.append(asyncio.create_task(asks.cancel("j")))
    await until(lambda: held.began == 4)
    with pytest.raises(BusyError):
        await asks.cancel("j")
    held.free.set()
    answers = await asyncio.gather(*asked)
    assert answers == [*(("plan", None, n) for n in range(3)),
                       ("capture.cancel", {"job": "j"}, module.ENGINE_S)]  # fmt: skip


def test_who_leaves_does_not_give_the_place_away(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(module, "WAIT_S", 0.0)
    free, began = threading.Event(), threading.Event()

    def fails() -> None:
        began.set()
        assert free.wait(PATIENCE_S)
        raise ZeroDivisionError

    async def scenario() -> None:
        turn = Turns(1, "the disk")
        asker = asyncio.create_task(turn.do(fails))
        await until(began.is_set)
        asker.cancel()
        ends = await asyncio.gather(asker, return_exceptions=True)
        assert isinstance(ends[0], asyncio.CancelledError)
        with pytest.raises(BusyError, match="too much is asked of the disk"):
            await turn.do(str, 5)
        free.set()
        await until(lambda: not turn._places.locked())
        with pytest.raises(ZeroDivisionError):
            await turn.do(divmod, 1, 0)
        await until(lambda: not turn._places.locked())
        assert await turn.do(divmod, 7, 2) == (3, 1)

    with caplog.at_level(logging.ERROR):
        asyncio.run(scenario())
        gc.collect()
    assert "never retrieved" not in caplog.text
