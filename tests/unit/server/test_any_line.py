"""An error at any line of the runner or its table: every job ends, the next runs, all is answered.

A tracer raises once, at one line of `runner.py`, `jobs.py` or `thinning.py`, on the loop's thread
or the engine's.
"""

from __future__ import annotations

import asyncio
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

import pytest

from pdcd.protocol.messages import ShowParams
from pdcd.server import jobs, runner, thinning
from pdcd.server.jobs import ENDED, Job
from tests.processes import LONG_S
from tests.unit.server.test_runner import ANNA, BERT, Desk, open_desk, until_cancelled

_Place = tuple[str, int]
"""A line: its file and number."""
WATCHED = (runner.__file__, jobs.__file__, thinning.__file__)


class UnheardOfError(BaseException):
    """Of no family that anybody would think of."""


def make_errors() -> tuple[BaseException, ...]:
    return (
        UnicodeEncodeError("utf-8", "\udce9", 0, 1, "surrogates not allowed"),
        MemoryError(), RecursionError("too deep"), UnheardOfError("?"), asyncio.CancelledError(),
        StopIteration(), OSError(24, "Too many open files"),
    )  # fmt: skip


class Tracer:
    """Counts how often each line is come to; at the `nth` time raises an error at one of them."""

    def __init__(self, at: _Place | None = None, nth: int = 1, error: Any = None) -> None:
        self.at, self.nth, self.error = at, nth, error
        self.seen: Counter[_Place] = Counter()
        self.raised = self.over = False

    def trace(self, frame: FrameType, event: str, arg: Any) -> Any:
        if self.over or frame.f_code.co_filename not in WATCHED:
            return None
        if event == "line":
            here = (frame.f_code.co_filename, frame.f_lineno)
            self.seen[here] += 1
            if here == self.at and self.seen[here] == self.nth:
                self.raised = True
                raise self.error
        return self.trace

    @contextmanager
    def watching(self) -> Iterator[None]:
        before = sys.gettrace(), threading.gettrace()
        threading.settrace(self.trace)  # before the engine's thread begins
        sys.settrace(self.trace)
        try:
            yield
        finally:
            self.over = True  # the engine's thread has it for life
            sys.settrace(before[0])
            threading.settrace(before[1])


async def go_about(desk: Desk, tracer: Tracer) -> list[Job]:
    """A show that gives way, a photo, two more that wait, of which one is cancelled. Each question
    may be answered by the error, for it may have been raised there."""
    begun: list[Job] = []

    def start(*given: Any, **more: Any) -> Job | None:
        with suppress(BaseException):
            begun.append(desk.start(*given, **more))
            return begun[-1]
        return None

    with tracer.watching():
        show = start(ANNA, ShowParams(pattern="grid"))
        await asyncio.sleep(0.002)
        photo, waits, last = start(ANNA), start(BERT, queue=True), start(BERT, queue=True)
        for job, ask in (
            (waits, desk.runner.cancel), (None if photo else show, desk.runner.cancel),
            (photo, desk.runner.wait), (last, desk.runner.answer),
        ):  # fmt: skip
            with suppress(BaseException):
                if job is not None:
                    await ask(job.name)
        for job in begun:
            await job.ended.wait()
    return begun


async def check_all_is_well(desk: Desk, begun: list[Job]) -> None:
    """What must hold afterwards."""
    for job in begun:
        assert job.state in ENDED and job.result is not None and job.result.state == job.state
        while job.untold:  # whoever waited may have heard before the news went out
            await asyncio.sleep(0)
        assert desk.of(job)[-1] in ENDED and not job.lit and job.place is None
    assert not desk.engine.shown or desk.engine.shown[-1] == ("black", 0)
    following = desk.start(BERT, queue=True)
    assert (await desk.runner.wait(following.name)).state == "done"
    desk.engine.act = until_cancelled
    last = desk.start(queue=True)
    while last.state == "queued":  # one of which nobody learned the name may be before it
        await asyncio.sleep(0.001)
    assert (await desk.runner.cancel(last.name)).state == "cancelled"
    await desk.runner.drain()
    assert desk.runner.table.running is None and not desk.runner.table.queue


async def test_an_error_at_any_line_ends_neither_the_runner_nor_a_job(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(runner, "_ANEW_S", 0.0)
    caplog.set_level("CRITICAL")
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: None)
    calm = Tracer()
    async with open_desk() as desk:
        await check_all_is_well(desk, await go_about(desk, calm))
    raised = 0
    for number, (at, count) in enumerate(sorted(calm.seen.items())):
        both = at[0] == runner.__file__  # of the table one will do
        for nth in sorted({1, count}) if both else [(1, count)[number % 2]]:
            errors = make_errors()
            tracer = Tracer(at, nth, errors[(number + nth) % len(errors)])
            async with open_desk() as desk:
                async with asyncio.timeout(LONG_S):
                    begun = await go_about(desk, tracer)
                    await check_all_is_well(desk, begun)
            raised += tracer.raised
    assert raised > 120  # lines of the two files, some of them twice
