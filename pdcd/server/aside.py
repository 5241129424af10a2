"""Calls that may hang, made where they hold up nobody."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

_P = ParamSpec("_P")
_R = TypeVar("_R")


async def call_in_thread(function: Callable[_P, _R], *args: _P.args, **kwargs: _P.kwargs) -> _R:
    """Make the call in a thread of its own and wait for what it returns or raises.

    A caller who waits no longer leaves the thread behind. It is no thread of a pool, so that one
    call that hangs does not hold up another, nor the end of the process.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[_R] = loop.create_future()

    def deliver(settle: Callable[[Any], None], value: object) -> None:
        if not done.cancelled():
            settle(value)

    def run() -> None:
        settle: Callable[[Any], None] = done.set_result
        value: object
        try:
            value = function(*args, **kwargs)
        # Whatever it raises belongs to the caller, as in a direct call.
        except BaseException as err:
            settle, value = done.set_exception, err
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(deliver, settle, value)

    thread = threading.Thread(target=run, name="pdcd-aside", daemon=True)
    thread.start()
    try:
        return await done
    finally:
        if not done.cancelled():
            thread.join()  # all that it has left to do is to end
