"""Calls that may take long or hang, a few at a time, each in a thread of its own; and questions to
the daemon, which are calls of this kind, each on a connection of its own.

So nothing has to be done when a daemon goes and comes back, and a daemon that hangs delays nothing
else.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pdcd.client import Client
from pdcd.errors import BusyError
from pdcd.server.aside import call_in_thread

LIVE_VIEWS = 2
"""Live views at a time: the visible one, and the next one, which replaces it."""
AT_A_TIME = 3
"""Questions at a time: the daemon allows one user only a few connections."""
ANSWER_S = 10.0
"""Longest time for an answer that needs no device, in seconds."""
ENGINE_S = 60.0
"""The same for an answer that needs the rig: a plan, a quick photo, the end of a job."""
CONNECT_S = 5.0
"""Longest time for the daemon's first words, in seconds."""

WAIT_S = 5.0
"""Longest time that a call waits for its turn, in seconds."""

_Params = Mapping[str, object]
_R = TypeVar("_R")


class Turns:
    """A number of places for calls of one kind; used from one event loop."""

    def __init__(self, places: int, what: str) -> None:
        """what : in words, for the error when no place is free."""
        self._places = asyncio.Semaphore(places)
        self._what = what

    async def do(self, function: Callable[..., _R], *args: object) -> _R:
        """What the call returns or raises. Raises BusyError when no place becomes free in time."""
        try:
            async with asyncio.timeout(WAIT_S):
                await self._places.acquire()
        except TimeoutError as err:
            raise BusyError(
                f"too much is asked of {self._what} at a time", hint="try again in a moment"
            ) from err
        loop = asyncio.get_running_loop()

        def held() -> _R:
            # A caller that leaves does not free the place while the call still hangs.
            try:
                return function(*args)
            finally:
                with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                    loop.call_soon_threadsafe(self._places.release)

        return await call_in_thread(held)


class DaemonQueries:
    """Asks the daemon on a socket; used from one event loop."""

    def __init__(self, socket: Path) -> None:
        self._socket = socket
        self._turns = Turns(AT_A_TIME, "the daemon")
        self._kept = Turns(1, "the daemon")
        self._following = 0

    async def ask(
        self, method: str, params: _Params | None = None, *, answer_s: float = ANSWER_S
    ) -> Any:
        """The answer, in JSON types. Raises the PdcdError that the daemon gave, BusyError when too
        many questions are asked at a time, and Unreachable."""
        return await self._turns.do(self._call, method, params, answer_s)

    async def cancel(self, job: str) -> Any:
        """End a job; it has a place of its own, so that it need not wait for a plan."""
        return await self._kept.do(self._call, "capture.cancel", {"job": job}, ENGINE_S)

    def follow(self, params: _Params) -> AsyncGenerator[Any, None]:
        """The pictures of a live view, the newest each time, on a connection of its own. The view
        ends when no more are asked for. Raises as `ask`, and the error that ended the view."""
        return self._follow("preview.live", params, "preview.frame", {}, ENGINE_S)

    def follow_stream(self, params: _Params) -> AsyncGenerator[Any, None]:
        """The same for a stream, after the name of its job, as many photos are taken before the
        first picture."""
        return self._follow("stream.start", params, "stream.frame", {"picture": "jpeg"}, None)

    async def _follow(
        self, start: str, params: _Params, see: str, wanted: _Params, answer_s: float | None
    ) -> AsyncGenerator[Any, None]:
        if self._following >= LIVE_VIEWS:
            raise BusyError("too many pages ask for a live view", hint="close some of them")
        self._following += 1
        client: Client | None = None
        try:
            client = await call_in_thread(Client, self._socket, CONNECT_S)
            started = await call_in_thread(client.call, start, params)
            frame: dict[str, Any] = {"number": 0}
            if answer_s is None:
                yield {"job": started["job"]}
            while True:
                asked = {"job": started["job"], "after": frame["number"], **wanted}
                frame = await call_in_thread(partial(client.answer, see, asked, timeout_s=answer_s))
                yield frame
        finally:
            self._following -= 1
            if client is not None:
                client.close()

    def _call(self, method: str, params: _Params | None, answer_s: float) -> Any:
        with Client(self._socket, CONNECT_S) as client:
            return client.call(method, params, timeout_s=answer_s)
