"""Calls that may take long or hang, a few at a time, each in a thread of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

from pdcd.errors import BusyError
from pdcd.server.aside import aside

R = TypeVar("R")

WAIT_S = 5.0
"""How long a call waits for its turn."""


class Turns:
    """So many places for calls of one kind; used from one event loop."""

    def __init__(self, places: int, what: str) -> None:
        """what : in words, for who finds no place."""
        self._places = asyncio.Semaphore(places)
        self._what = what
        self._open: set[asyncio.Task[Any]] = set()

    async def do(self, function: Callable[..., R], *args: Any) -> R:
        """What the call returns or raises. Raises BusyError where none of the places is free."""
        try:
            async with asyncio.timeout(WAIT_S):
                await self._places.acquire()
        except TimeoutError as err:
            raise BusyError(
                f"too much is asked of {self._what} at a time", hint="try again in a moment"
            ) from err
        # Who leaves must not give the place away while the call still hangs.
        task = asyncio.create_task(self._held(function, *args))
        self._open.add(task)
        task.add_done_callback(self._over)
        return await asyncio.shield(task)

    async def close(self) -> None:
        """Wait no more for what is called."""
        for task in list(self._open):
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)

    async def _held(self, function: Callable[..., R], *args: Any) -> R:
        try:
            return await aside(function, *args)
        finally:
            self._places.release()

    def _over(self, task: asyncio.Task[Any]) -> None:
        self._open.discard(task)
        if not task.cancelled():
            task.exception()  # looked at, even where the browser has left and nobody else does
