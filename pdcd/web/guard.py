"""How many connections there are, and how long each may take: whatever a client does or leaves.

The server's own protocol parses what comes. A `Guard` stands before it and counts: who has not
shown the key of the page is a stranger, and strangers have few places and little time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

STRANGERS = 32
"""Connections that have not shown the key, at a time."""
MOST = 64
"""Connections at a time."""
STRANGER_S = 5.0
"""From the first byte to the last of a request without the key, in seconds."""
REQUEST_S = 30.0
"""The same for a whole request with the key, its answer included."""


class Guards:
    """The connections of one server; used from its event loop only."""

    def __init__(self, make: Callable[[], asyncio.Protocol]) -> None:
        """make : a protocol of the server for each connection."""
        self._make = make
        self._all: dict[asyncio.BaseTransport, Guard] = {}

    def __call__(self) -> Guard:
        """A protocol for one more connection, as `loop.create_server` takes it."""
        return Guard(self, self._make())

    def __len__(self) -> int:
        return len(self._all)

    @property
    def strangers(self) -> int:
        """Connections that have not shown the key."""
        return sum(guard.stranger for guard in self._all.values())

    def known(self, transport: asyncio.BaseTransport | None, seconds: float | None) -> None:
        """The request on this connection showed the key; it has so many seconds from now on, or
        no limit: then whoever answers it sees that it ends."""
        guard = None if transport is None else self._all.get(transport)
        if guard is not None:
            guard.known(seconds)

    def enter(self, transport: asyncio.BaseTransport, guard: Guard) -> bool:
        """Whether there is a place for one more."""
        if len(self._all) >= MOST or self.strangers >= STRANGERS:
            return False
        self._all[transport] = guard
        return True

    def leave(self, transport: asyncio.BaseTransport) -> None:
        """A connection has ended."""
        self._all.pop(transport, None)

    def end(self) -> None:
        """End all connections at once."""
        for transport in list(self._all):
            if isinstance(transport, asyncio.WriteTransport):
                transport.abort()


class Guard(asyncio.Protocol):
    """One connection, before the protocol of the server that serves it."""

    def __init__(self, guards: Guards, inner: asyncio.Protocol) -> None:
        self._guards = guards
        self._inner = inner
        self._transport: asyncio.Transport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._entered = False
        self.stranger = True

    def known(self, seconds: float | None) -> None:
        """See `Guards.known`."""
        self.stranger = False
        self._allow(seconds)

    def _allow(self, seconds: float | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if seconds is not None and self._transport is not None:
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(seconds, self._transport.abort)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a place, or end the connection."""
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("a guard stands before connections of a stream")
        self._transport = transport
        self._entered = self._guards.enter(transport, self)
        if not self._entered:
            transport.abort()
            return
        self._allow(STRANGER_S)
        self._inner.connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back."""
        self._allow(None)
        if self._entered and self._transport is not None:
            self._guards.leave(self._transport)
            self._inner.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Pass on."""
        if self._entered:
            self._inner.data_received(data)

    def eof_received(self) -> bool | None:
        """Pass on."""
        return self._inner.eof_received() if self._entered else None

    def pause_writing(self) -> None:
        """Pass on."""
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        """Pass on."""
        self._inner.resume_writing()
