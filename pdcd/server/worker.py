"""The one thread in which every engine call runs, and its signs of life.

Devices and GL contexts belong to a thread, and an exposure must not be disturbed by a second call;
so there is exactly one thread, and calls queue up for it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import ParamSpec, TypeVar

from pdcd.server.aside import Outcome

ENGINE_THREAD = "pdcd-engine"
"""Prefix of the thread's name."""

_P = ParamSpec("_P")
_R = TypeVar("_R")


class EngineThread:
    """Runs calls one after the other in one thread of its own."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix=ENGINE_THREAD)
        self._probe: Future[None] | None = None
        self.beats = 0
        """Grows while the thread lives; written by the thread, read by the watchdog."""

    def beat(self) -> None:
        """Called in the thread from inside a long call, to show that it is not stuck."""
        self.beats += 1

    def probe(self) -> None:
        """Make an idle thread beat; a busy one beats by itself, or hangs."""
        if self._probe is None or self._probe.done():
            self._probe = self._pool.submit(self.beat)

    async def call(self, function: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Run the call in the thread and wait for what it returns or raises."""
        made = self._pool.submit(Outcome.of, partial(function, *args, **kwargs))
        done = asyncio.wrap_future(made)
        if done.done():  # the loop has yet to hear what it was told on the way
            await asyncio.sleep(0)
        return (await done).get()

    def close(self) -> None:
        """End the thread after the calls that were made. Blocks until then."""
        self._pool.shutdown(wait=True)
