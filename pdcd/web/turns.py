"""Calls that may take long or hang, a few at a time, each in a thread of its own."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import TypeVar

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

    async def do(self, function: Callable[..., R], *args: object) -> R:
        """What the call returns or raises. Raises BusyError where none of the places is free."""
        try:
            async with asyncio.timeout(WAIT_S):
                await self._places.acquire()
        except TimeoutError as err:
            raise BusyError(
                f"too much is asked of {self._what} at a time", hint="try again in a moment"
            ) from err
        loop = asyncio.get_running_loop()

        def held() -> R:
            # Who leaves does not give the place away while the call still hangs.
            try:
                return function(*args)
            finally:
                with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                    loop.call_soon_threadsafe(self._places.release)

        return await aside(held)
