"""Connects the loop with the engine's thread while a stream runs."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress

from pdcd.errors import BusyError, Cancelled, RequestError
from pdcd.protocol.result import CaptureResult, make_job_id
from pdcd.runs.place import HeldFolder
from pdcd.runs.recording import RecordOrder, StreamListener
from pdcd.server.jobs import ENDED, Job

_DRAWN_S = 2.0
"""How long pictures of a stream are drawn after somebody asked for one."""
_MOST_RECORDS = 4
"""Runs of one stream that may be waiting to be made."""


def make_stream_listener(
    job: Job, loop: asyncio.AbstractEventLoop, cancelled: Callable[[], bool]
) -> StreamListener:
    """The listener to the stream of a job, which passes calls from the engine's threads on to the
    loop.

    `cancelled` also signals that the engine's thread is alive. Only that thread calls
    `next_record`; the thread that makes pictures does not.
    """

    def next_record() -> RecordOrder | None:
        with suppress(IndexError):
            return job.records.popleft()
        return None

    return StreamListener(
        tell=lambda frame: loop.call_soon_threadsafe(job.see, frame),
        cancelled=cancelled,
        draws=lambda: time.monotonic() - job.looked_s < _DRAWN_S,
        next_record=next_record,
    )


async def order_record(job: Job, place: HeldFolder) -> CaptureResult:
    """Have a run made of the newest photos of a stream, and wait for it.

    Raises RequestError for one that has ended, BusyError where enough runs are ordered already,
    Cancelled where the stream ends first.
    """
    loop, made = asyncio.get_running_loop(), asyncio.Event()
    results: list[CaptureResult] = []

    def done(result: CaptureResult) -> None:
        results.append(result)
        loop.call_soon_threadsafe(made.set)

    if job.state in ENDED:
        raise RequestError(f"job {job.name} has ended", hint="record while it runs")
    if len(job.records) >= _MOST_RECORDS:
        raise BusyError(f"{len(job.records)} runs of job {job.name} are wanted already")
    job.records.append(RecordOrder(make_job_id(), place, done))
    waits = [asyncio.create_task(event.wait()) for event in (made, job.ended)]
    try:
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for wait in waits:
            wait.cancel()
    if not results:
        raise Cancelled("the stream ended before a run was made of it")
    return results[0]
