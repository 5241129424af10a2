"""Access control: only requests with the printed token are answered, and no other site's page.

The token follows the # of the printed address. Browsers send that part to no server, so it is in no
request line and no log. The page keeps it where only pages of this very address can read it, and
sends it in a header that no other site's request has.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import secrets

from aiohttp import web

STRANGERS = 128
"""Most connections at a time that have not shown the token."""
STAY_S = 0.25
"""For how long such a connection keeps its place when others come, in seconds: a browser with the
token has shown it by then."""
STRANGER_S = 5.0
"""Longest time of a request without the token, from its first to its last byte, in seconds."""
REQUEST_S = 30.0
"""Longest time of a request with the token, its answer included, in seconds."""


class Refusal(Exception):  # noqa: N818 - reads as the state it reports
    """A request that is refused: the HTTP status, and a word on why."""

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
        """The address with the token, which is printed."""
        return f"http://{self.host}/#{self._token}"

    def check_host(self, request: web.Request) -> None:
        """Refuse a request for another host, such as a foreign name that resolves to this machine.
        Raises Refusal."""
        if request.headers.getall("Host", []) != [self.host]:
            raise Refusal(403, "the request is for another host")

    def check_token(self, request: web.Request) -> None:
        """Refuse a request without the token. Raises Refusal."""
        given = request.headers.getall("Authorization", [])
        if len(given) != 1 or not _same(given[0], f"Bearer {self._token}"):
            raise Refusal(401, "open the address that pdcd web printed")

    def ticket(self, job: str) -> str:
        """A key to the report of one run, as a tab of its own cannot send the token.

        A report may have been made by anybody: it must not learn the token.
        """
        return hmac.new(self._token.encode(), job.encode(), hashlib.sha256).hexdigest()

    def check_ticket(self, job: str, ticket: str) -> None:
        """Refuse a request without the ticket of this run. Raises Refusal."""
        if not _same(ticket, self.ticket(job)):
            raise Refusal(404, "no such address: open the report from the page")


def _same(given: str, wanted: str) -> bool:
    return secrets.compare_digest(given.encode(errors="replace"), wanted.encode())


class VisitorPlaces:
    """The connections of one server: strangers have few places and little time.

    A connection is a stranger until its request has shown the token. When all places of strangers
    are taken, the oldest stranger has to leave for the next one, so that nobody can block the
    places. The next one first waits (`wait_s`) until the oldest has had its time, so that a crowd
    cannot sweep connections out before their requests are read.
    """

    def __init__(self) -> None:
        self._timers: dict[asyncio.Transport, asyncio.TimerHandle | None] = {}
        self._strangers: dict[asyncio.Transport, float] = {}
        """Strangers and when they came, by the loop's clock; the oldest first."""

    def wait_s(self) -> float:
        """How long the next connection has to wait, in seconds."""
        if len(self._strangers) < STRANGERS:
            return 0.0
        first_s = next(iter(self._strangers.values()))
        return max(0.0, first_s + STAY_S - asyncio.get_running_loop().time())

    def enter(self, transport: asyncio.Transport) -> None:
        """Take in one more stranger."""
        if len(self._strangers) >= STRANGERS:
            first = next(iter(self._strangers))
            self.leave(first)
            first.abort()
        self._strangers[transport] = asyncio.get_running_loop().time()
        self._allow(transport, STRANGER_S)

    def admit(self, transport: asyncio.BaseTransport | None, seconds: float | None) -> None:
        """The request on this connection may be answered, within `seconds` from now. None is no
        limit: then the code that answers it must see that it ends."""
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
    """A connection of the library, with a place among `VisitorPlaces`."""

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
        """Give the place back."""
        if self._place is not None:
            self._places.leave(self._place)
        super().connection_lost(exc)
