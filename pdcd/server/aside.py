"""Calls that may hang, made where they hold up nobody, and what comes of calls in other threads."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import Generic, NamedTuple, ParamSpec, TypeVar, cast

_P = ParamSpec("_P")
_R = TypeVar("_R")


class Outcome(NamedTuple, Generic[_R]):
    """What a call returned or raised, as a value: for not every error may pass through a future,
    and some would end the loop."""

    value: _R | None
    error: BaseException | None

    @classmethod
    def of(cls, call: Callable[[], _R]) -> Outcome[_R]:
        """Make the call, in whatever thread this is."""
        try:
            return cls(call(), None)
        # Whatever it raises belongs to the caller, as in a direct call.
        except BaseException as err:
            return cls(None, err)

    def get(self) -> _R:
        """The value, or the error raised: one that would end more than the caller, as SystemExit
        does, as a RuntimeError. No frame on its way goes on knowing it: an error that its own
        frames know is kept, with all that they know, until the next search for such circles."""
        try:
            if isinstance(self.error, Exception):
                raise self.error
            if self.error is not None:
                raise RuntimeError(f"{type(self.error).__name__} was raised") from self.error
            return cast(_R, self.value)
        finally:
            del self


def finish_future(future: asyncio.Future[_R], value: _R) -> None:
    """In the loop: end the wait of whoever still waits."""
    if not future.done():
        future.set_result(value)


async def call_in_thread(function: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
    """Make the call in a thread of its own and wait for what it returns or raises.

    A caller who waits no longer leaves the thread behind. It is no thread of a pool, so that one
    call that hangs does not hold up another, nor the end of the process.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Outcome[_R]] = loop.create_future()

    def run(waiting: asyncio.Future[Outcome[_R]]) -> None:
        outcome = Outcome.of(lambda: function(*args, **kwargs))
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(finish_future, waiting, outcome)
        del outcome, waiting

    thread = threading.Thread(target=run, args=(done,), name="pdcd-aside", daemon=True)
    thread.start()
    try:
        return (await done).get()
    finally:
        if not done.cancelled():
            thread.join()  # all that it has left to do is to end
        del done
