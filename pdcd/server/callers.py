"""A caller as the server sees it: who it is, and the lines that wait to be sent to it."""

from __future__ import annotations

import asyncio
import logging
import os
from collections import deque
from typing import NamedTuple

from pdcd.protocol.messages import MAX_LINE, Interest
from pdcd.protocol.views import ClientRole
from pdcd.server.access import Peer
from pdcd.server.stream import Stream

logger = logging.getLogger(__name__)

QUEUE_LINES = 256
"""Lines that may wait for a slow client; beyond that, thinned events are dropped, then the
client."""

QUEUE_BYTES = 8 * MAX_LINE
"""Bytes of those lines."""

STUCK_S = 5.0
"""How long a client may leave its socket full, in seconds."""


class _Waiting(NamedTuple):
    """A line to be sent, whether it may be dropped, and a descriptor that goes with it."""

    line: bytes
    droppable: bool
    fd: int | None

    def close(self) -> None:
        """Close the descriptor."""
        if self.fd is not None:
            os.close(self.fd)


class Caller:
    """One connection: who it is, which events it subscribed to, and the lines that wait for it.

    `role` is what it may do; it does not change while it is connected.
    """

    def __init__(self, number: int, peer: Peer, role: ClientRole, stream: Stream) -> None:
        self.number = number
        self.peer = peer
        self.role = role
        self.interest: Interest = "none"
        self.gone = False
        """True once the client has left."""
        self.idle_s = 0.0
        """How long it has asked for nothing."""
        self._stream = stream
        self._lines: deque[_Waiting] = deque()
        self._bytes = 0
        self._changed = asyncio.Event()
        self._finishing = False

    def send(self, line: bytes, *, droppable: bool = False, fd: int | None = None) -> None:
        """Queue a line, with a descriptor to be sent with it, which is closed afterwards; never
        blocks. A full queue costs thinned events, then the client."""
        entry = _Waiting(line, droppable, fd)
        if self._finishing:
            entry.close()
            return
        if len(self._lines) >= QUEUE_LINES or self._bytes + len(line) > QUEUE_BYTES:
            if droppable:
                return
            stale = next((entry for entry in self._lines if entry.droppable), None)
            if stale is None:
                entry.close()
                self.abort("its queue is full")
                return
            self._lines.remove(stale)
            self._bytes -= len(stale.line)
        self._lines.append(entry)
        self._bytes += len(line)
        self._changed.set()

    async def room(self) -> None:
        """Wait until half the queue is free, so that a burst of requests does not cost the
        client."""
        while not self._stream.is_cut and (
            len(self._lines) > QUEUE_LINES // 2 or self._bytes > QUEUE_BYTES // 8
        ):
            await self._wait_change()

    async def pump(self) -> None:
        """Write the queued lines until `finish`; a client that does not read is cut off."""
        try:
            while self._lines or not self._finishing:
                if not self._lines:
                    await self._wait_change()
                    continue
                entry = self._lines.popleft()
                self._bytes -= len(entry.line)
                self._changed.set()
                try:
                    async with asyncio.timeout(STUCK_S):
                        await self._stream.send(entry.line, entry.fd)
                finally:
                    entry.close()
        except TimeoutError:
            self.abort(f"it has not read for {STUCK_S:g} s")
        except OSError:
            self._cut()  # it has closed its end, which is not worth a warning

    def finish(self) -> None:
        """Let `pump` end when the queue is empty."""
        self._finishing = True
        self._changed.set()

    def abort(self, reason: str) -> None:
        """Cut the connection; its reader then sees the end of the stream."""
        logger.warning("client dropped connection=%d reason=%r", self.number, reason)
        self._cut()

    def _cut(self) -> None:
        for entry in self._lines:
            entry.close()
        self._lines.clear()
        self._bytes = 0
        self._stream.cut()
        self.finish()

    async def _wait_change(self) -> None:
        self._changed.clear()
        await self._changed.wait()
