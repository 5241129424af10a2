"""Who is let in: whoever shows the token that was printed, and nobody else's page.

The token stands behind the # of the printed address. Browsers send that part to no server, so it is
in no request line and no log. The page keeps it where only pages of this very address can read it,
and shows it in a header that no other site's request has.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import secrets

from aiohttp import web

STRANGERS = 128
"""Connections that have not shown the token, at a time."""
STAY_S = 0.25
"""For how long one of them is safe from the next that comes, in seconds: whoever has the token has
shown it by then."""
STRANGER_S = 5.0
"""From the first byte to the last of a request without the token, in seconds."""
REQUEST_S = 30.0
"""The same for a whole request with the token, its answer included."""


class Refusal(Exception):  # noqa: N818 - reads as the state it reports
    """A request that is not answered: the status of HTTP, and a word on why."""

    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status
        self.why = why


class BrowserAuth:
    """The rules for one server, which listens at `host` (an address of the loopback) and `port`."""

    def __init__(self, host: str, port: int) -> None:
        self.host = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self._token = secrets.token_urlsafe(32)

    @property
    def address(self) -> str:
        """What is printed."""
        return f"http://{self.host}/#{self._token}"

    def check_host(self, request: web.Request) -> None:
        """Refuse what means another host: a name of somebody else's that leads here. Raises
        Refused."""
        if request.headers.getall("Host", []) != [self.host]:
            raise Refusal(403, "another host is meant")

    def check_token(self, request: web.Request) -> None:
        """Refuse who has no token. Raises Refused."""
        given = request.headers.getall("Authorization", [])
        if len(given) != 1 or not _same(given[0], f"Bearer {self._token}"):
            raise Refusal(401, "open the address that pdcd web printed")

    def ticket(self, job: str) -> str:
        """What opens the report of one run without the token, as a tab of its own cannot show it.

        A report may be anybody's page: it must not learn the token.
        """
        return hmac.new(self._token.encode(), job.encode(), hashlib.sha256).hexdigest()

    def check_ticket(self, job: str, ticket: str) -> None:
        """Refuse who was not given the ticket of that run. Raises Refused."""
        if not _same(ticket, self.ticket(job)):
            raise Refusal(404, "no such address: open the report from the page")


def _same(given: str, wanted: str) -> bool:
    return secrets.compare_digest(given.encode(errors="replace"), wanted.encode())


class VisitorPlaces:
    """The connections of one server: strangers have few places and little time.

    A connection is a stranger until its request has shown the token. Where all places of strangers
    are taken, whoever came first goes: nobody is kept out by those who hold theirs. Others wait at
    the door (`wait_s`) until that one has had its time, so that nobody is swept out by those who
    come in crowds, again and again, before a request could be read.
    """

    def __init__(self) -> None:
        self._timers: dict[asyncio.Transport, asyncio.TimerHandle | None] = {}
        self._strangers: dict[asyncio.Transport, float] = {}
        """And when they came, by the loop's clock; the first of them first."""

    def wait_s(self) -> float:
        """How long the next that comes has to wait, in seconds."""
        if len(self._strangers) < STRANGERS:
            return 0.0
        first_s = next(iter(self._strangers.values()))
        return max(0.0, first_s + STAY_S - asyncio.get_running_loop().time())

    def enter(self, transport: asyncio.Transport) -> None:
        """One more stranger."""
        if len(self._strangers) >= STRANGERS:
            first = next(iter(self._strangers))
            self.leave(first)
            first.abort()
        self._strangers[transport] = asyncio.get_running_loop().time()
        self._allow(transport, STRANGER_S)

    def admit(self, transport: asyncio.BaseTransport | None, seconds: float | None) -> None:
        """The request on this connection may be answered; it has so many seconds from now on, or no
        limit: then whoever answers it sees that it ends."""
        if isinstance(transport, asyncio.Transport) and transport in self._timers:
            self._strangers.pop(transport, None)
            self._allow(transport, seconds)

    def leave(self, transport: asyncio.Transport) -> None:
        """A connection has ended. Idempotent."""
        self._allow(transport, None)
        self._strangers.pop(transport, None)
        self._timers.pop(transport, None)

    def end(self) -> None:
        """End all connections at once."""
        for transport in list(self._timers):
            transport.abort()

    def _allow(self, transport: asyncio.Transport, seconds: float | None) -> None:
        timer = self._timers.get(transport)
        if timer is not None:
            timer.cancel()
        loop = asyncio.get_running_loop()
        self._timers[transport] = (
            None if seconds is None else loop.call_later(seconds, transport.abort)
        )


class VisitorConnection(web.RequestHandler):
    """A connection as the library serves it, in a place of its own."""

    def __init__(self, places: VisitorPlaces, server: web.Server, **limits: object) -> None:
        super().__init__(server, loop=asyncio.get_running_loop(), **limits)  # type: ignore[arg-type]
        self._places = places
        self._place: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the place."""
        super().connection_made(transport)
        if isinstance(transport, asyncio.Transport):
            self._place = transport
            self._places.enter(transport)

    def connection_lost(self, exc: BaseException | None) -> None:
        """Give it back."""
        if self._place is not None:
            self._places.leave(self._place)
        super().connection_lost(exc)
