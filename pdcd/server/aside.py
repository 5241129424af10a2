"""Calls that may hang, made in threads where they hold up nobody, and the outcomes of such
calls."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import Generic, NamedTuple, ParamSpec, TypeVar, cast

_P = ParamSpec("_P")
_R = TypeVar("_R")


class Outcome(NamedTuple, Generic[_R]):
    """What a call returned or raised, as a value: not every error may pass through a future, and
    some would end the loop."""

    value: _R | None
    error: BaseException | None

    @classmethod
    def of(cls, call: Callable[[], _R]) -> Outcome[_R]:
        """Make the call, in the current thread."""
        try:
            return cls(call(), None)
        # Any error belongs to the caller, as in a direct call.
        except BaseException as err:
            return cls(None, err)

    def get(self) -> _R:
        """Return the value, or raise the error. An error that would end more than the caller, such
        as SystemExit, is raised as a RuntimeError. No frame on the way keeps a reference to it: an
        error that its own frames refer to stays alive, with all that these refer to, until the next
        garbage collection of cycles."""
        try:
            if isinstance(self.error, Exception):
                raise self.error
            if self.error is not None:
                raise RuntimeError(f"{type(self.error).__name__} was raised") from self.error
            return cast(_R, self.value)
        finally:
            del self


def finish_future(future: asyncio.Future[_R], value: _R) -> None:
    """In the loop: give the value to a future, if anyone still waits for it."""
    if not future.done():
        future.set_result(value)


async def call_in_thread(function: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
    """Make the call in a thread of its own and wait for what it returns or raises.

    If the caller stops waiting, the thread is left behind. It does not belong to a pool, so that
    one call that hangs holds up neither another one nor the end of the process.
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
            thread.join()  # it has nothing left to do
        del done
