"""File descriptors that came with requests, from their receipt to their closing."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable, Iterable

from pdcd.errors import BusyError, ProtocolError
from pdcd.protocol.messages import MAX_FDS
from pdcd.server.aside import call_in_thread


def _close_aside(fds: tuple[int, ...]) -> asyncio.Task[None]:
    """Close them in a thread: `close` may wait for a file system or a peer of the client's own."""
    return asyncio.create_task(call_in_thread(_close_all, fds))


class Descriptors:
    """The descriptors of one connection. It owns each of them until it is closed.

    ::

        receive ──> unclaimed ──> take ──> a request has them ──> release ──> closed
                        └───────────────────── close ────────────────────────┘

    `closer` closes some and returns the task that does so. Used from the event loop only.
    """

    def __init__(
        self, closer: Callable[[tuple[int, ...]], asyncio.Task[None]] = _close_aside
    ) -> None:
        self._closer = closer
        self._unclaimed: list[int] = []
        self._taken: set[int] = set()
        self._closing: dict[asyncio.Task[None], int] = {}

    @property
    def unclaimed(self) -> int:
        """How many descriptors came that no request has claimed yet."""
        return len(self._unclaimed)

    def receive(self, fds: Iterable[int]) -> None:
        """Take over descriptors that came, in order."""
        self._unclaimed += fds

    def take(self, count: int) -> tuple[int, ...]:
        """The next `count` descriptors, for a request.

        Raises ProtocolError when fewer came, BusyError when other requests hold too many.
        """
        if count > len(self._unclaimed):
            raise ProtocolError(
                f"the request names {count} descriptors, {len(self._unclaimed)} came with it",
                hint="send descriptors in the same message as the first byte of their request",
            )
        taken, self._unclaimed = tuple(self._unclaimed[:count]), self._unclaimed[count:]
        if len(self._taken) + sum(self._closing.values()) + count > MAX_FDS:
            self._close(taken)
            raise BusyError(
                f"requests of this connection hold more than {MAX_FDS} descriptors",
                hint="wait for answers before sending more",
            )
        self._taken.update(taken)
        return taken

    def release(self, fds: tuple[int, ...]) -> None:
        """The request that took them has been answered: close them."""
        mine = tuple(fd for fd in fds if fd in self._taken)
        self._taken.difference_update(mine)
        self._close(mine)

    def drop_unclaimed(self) -> None:
        """Close what no request has taken."""
        left, self._unclaimed = tuple(self._unclaimed), []
        self._close(left)

    def close(self) -> None:
        """Begin to close all that is left, taken or not. Idempotent."""
        self.drop_unclaimed()
        left, self._taken = tuple(self._taken), set()
        self._close(left)

    async def settle(self, within_s: float) -> None:
        """Wait until all that was released is closed, but not longer than that."""
        if self._closing:
            await asyncio.wait(list(self._closing), timeout=within_s)

    async def end(self) -> None:
        """Close all and wait until that is done, which may take forever."""
        self.close()
        try:
            while self._closing:
                await asyncio.wait(list(self._closing))
        finally:
            for task in self._closing:
                task.cancel()

    def _close(self, fds: tuple[int, ...]) -> None:
        if not fds:
            return
        task = self._closer(fds)
        self._closing[task] = len(fds)
        task.add_done_callback(lambda task: self._closing.pop(task, None) and None)


def _close_all(fds: tuple[int, ...]) -> None:
    for fd in fds:
        with contextlib.suppress(OSError):  # an error of writing back is the client's affair
            os.close(fd)
