"""Threads that read what clients pass, so that a disk that hangs holds up nobody else.

A read from a network mount, or from a file system that a client itself serves, may never return,
and no time limit ends it. So each read has a thread of its own, which is left behind when its time
is over. Threads are counted until they really end, for each user and in total: a user whose files
hang can soon pass no more, and others still can. Users take turns.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

from pdcd.errors import BusyError, RequestError
from pdcd.server.aside import Outcome, finish_future
from pdcd.server.turns import UserTurns

_T = TypeVar("_T")
_Alive = Callable[[], None]

LIMIT_S = 10.0
"""Time for reading all arrays of one request, in seconds."""
EACH, ALL_READERS = 2, 8
"""Reading threads for one user, and in total."""
_LOOK_S = 0.01
"""Time between two checks for free memory, in seconds."""


class _Over(Exception):  # noqa: N818 - reads as the state it reports
    """Nobody waits for this read any more."""


class Readers:
    """Runs calls in threads that may be left behind. Used from one event loop."""

    def __init__(
        self, *, each: int = EACH, total: int = ALL_READERS, limit_s: float = LIMIT_S
    ) -> None:
        self._turns, self._limit_s = UserTurns(each, total), limit_s

    async def run(
        self,
        uid: int,
        prepare: Callable[[], Callable[[_Alive], _T]],
        room: Callable[[], bool] = lambda: True,
    ) -> _T:
        """What a read returns or raises, for a user.

        Parameters
        ----------
        prepare : called in the loop when another thread is allowed; returns the read. The read is
            given a function that it must call often, and that raises when the time is over.
        room : whether there is memory for it.

        Raises BusyError when no thread or no memory becomes free in time, RequestError when the
        read takes longer.
        """
        try:
            # Time for earlier ones to end: requests of one client come in bursts.
            async with asyncio.timeout(self._limit_s):
                await self._turns.take(uid)
                await self._wait_for(uid, room)
        except TimeoutError as err:
            raise BusyError(
                "requests that wait hold too many arrays", hint="wait until some are answered"
            ) from err
        try:
            function = prepare()
        except BaseException:
            self._turns.give_back(uid)
            raise
        done, over = self._started(uid, function)
        try:
            return (await asyncio.wait_for(done, self._limit_s)).get()
        except (TimeoutError, _Over) as err:
            raise RequestError(
                f"its arrays could not be read within {self._limit_s:g} s",
                hint="give files of a disk that answers",
            ) from err
        finally:
            over.set()
            del done

    def _started(
        self, uid: int, function: Callable[[_Alive], _T]
    ) -> tuple[asyncio.Future[Outcome[_T]], threading.Event]:
        """Run the function in a thread; returns its future, and the event that tells it to end."""
        loop = asyncio.get_running_loop()
        done: asyncio.Future[Outcome[_T]] = loop.create_future()
        over = threading.Event()

        def alive() -> None:
            if over.is_set():
                raise _Over

        def body(waiting: asyncio.Future[Outcome[_T]]) -> None:
            outcome = Outcome.of(lambda: function(alive))
            with suppress(RuntimeError):  # the loop has ended meanwhile
                loop.call_soon_threadsafe(self._turns.give_back, uid)
                loop.call_soon_threadsafe(finish_future, waiting, outcome)
            del outcome, waiting

        try:
            name = "pdcd-reader"
            threading.Thread(target=body, args=(done,), name=name, daemon=True).start()
        except RuntimeError:  # there are too many
            self._turns.give_back(uid)
            raise
        return done, over

    async def _wait_for(self, uid: int, room: Callable[[], bool]) -> None:
        """Hold a place until there is room; it is given back if there never is."""
        try:
            while not room():
                await asyncio.sleep(_LOOK_S)
        except BaseException:
            self._turns.give_back(uid)
            raise
