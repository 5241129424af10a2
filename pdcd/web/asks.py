"""Questions to the daemon, each on a connection of its own and in a thread of its own.

So a daemon that goes and comes back needs nothing from us, and one that hangs holds up nobody else.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pdcd.client import Client
from pdcd.errors import BusyError
from pdcd.server.aside import aside

AT_A_TIME = 3
"""Questions at a time: the daemon has few places for the connections of one user."""
ANSWER_S = 10.0
"""How long an answer may take that needs no device, in seconds."""
ENGINE_S = 60.0
"""The same where the rig is needed: a plan, a quick photo, the end of a job."""
CONNECT_S = 5.0
WAIT_S = 5.0
"""How long a question waits for its turn."""


class Asks:
    """Asks the daemon on a socket; used from one event loop."""

    def __init__(self, socket: Path) -> None:
        self._socket = socket
        self._places = asyncio.Semaphore(AT_A_TIME)
        self._kept = asyncio.Semaphore(1)
        self._open: set[asyncio.Task[Any]] = set()

    async def ask(
        self,
        method: str,
        params: Mapping[str, object] | None = None,
        *,
        answer_s: float = ANSWER_S,
    ) -> Any:
        """The answer, in JSON types. Raises the PdcdError that the daemon gave, BusyError where too
        much is asked at a time, and Unreachable."""
        return await self._ask(self._places, method, params, answer_s)

    async def cancel(self, job: str) -> Any:
        """End a job; has a place kept for it, so that it need not wait for a plan."""
        return await self._ask(self._kept, "capture.cancel", {"job": job}, ENGINE_S)

    async def close(self) -> None:
        """Wait no more for answers."""
        for task in list(self._open):
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)

    async def _ask(
        self,
        places: asyncio.Semaphore,
        method: str,
        params: Mapping[str, object] | None,
        answer_s: float,
    ) -> Any:
        try:
            async with asyncio.timeout(WAIT_S):
                await places.acquire()
        except TimeoutError as err:
            raise BusyError(
                "too much is asked of the daemon at a time", hint="try again in a moment"
            ) from err
        # A browser that leaves must not give its place away while its question is still open.
        task = asyncio.create_task(self._held(places, method, params, answer_s))
        self._open.add(task)
        task.add_done_callback(self._over)
        return await asyncio.shield(task)

    def _over(self, task: asyncio.Task[Any]) -> None:
        self._open.discard(task)
        if not task.cancelled():
            task.exception()  # looked at, even where the browser has left and nobody else does

    async def _held(
        self,
        places: asyncio.Semaphore,
        method: str,
        params: Mapping[str, object] | None,
        answer_s: float,
    ) -> Any:
        try:
            return await aside(self._call, method, params, answer_s)
        finally:
            places.release()

    def _call(self, method: str, params: Mapping[str, object] | None, answer_s: float) -> Any:
        with Client(self._socket, CONNECT_S) as client:
            return client.call(method, params, timeout_s=answer_s)
