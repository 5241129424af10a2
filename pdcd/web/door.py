"""Who is let in: one browser, by a token in the address that was printed, and nobody else's page.

The token is good once. It is exchanged for a cookie, which no script can read and no other site's
request carries. Browsers send cookies of a host to all of its ports, so the cookie is bound to a
path that only that browser learns. Every request is looked at besides: which host it means, and
which page it comes from.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie

ENTER = "/enter/"
"""What the printed address begins with; the token follows."""
REPORT = "/report/"
"""What the address of a report begins with; a ticket follows."""
MOST_TICKETS = 64
"""Reports that can be loaded again, the last that were opened."""

_PATH = re.compile(r"/[A-Za-z0-9._/-]{0,255}")
"""What an address of ours may look like: no query, and nothing to be decoded."""
_EMPTY_OR_DOTS = re.compile(r"//|/\.")
_JSON = "application/json"
_PAGES = ("same-origin", "none")
"""`Sec-Fetch-Site` of requests of our own page, and of addresses that a person typed."""


class Refused(Exception):  # noqa: N818 - reads as the state it reports
    """A request that is not answered: the status of HTTP, and a word on why."""

    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status
        self.why = why


@dataclass(frozen=True)
class Asked:
    """A request as its head has it: `path` as it was sent, headers in order."""

    method: str
    path: str
    headers: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, method: str, path: str, headers: Iterable[tuple[str, str]]) -> Asked:
        """The names of headers in small letters."""
        return cls(method, path, tuple((name.lower(), value) for name, value in headers))

    def all(self, name: str) -> list[str]:
        """Every value of a header."""
        return [value for key, value in self.headers if key == name]

    def one(self, name: str) -> str | None:
        """The value of a header that may come once. Raises Refused where it comes twice."""
        values = self.all(name)
        if len(values) > 1:
            raise Refused(400, f"{name} comes twice")
        return values[0] if values else None


class Door:
    """The rules for one server, which listens at `host` (an address of the loopback) and `port`."""

    def __init__(self, host: str, port: int) -> None:
        self.host = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self.origin = f"http://{self.host}"
        self.room = f"/{secrets.token_urlsafe(12)}"
        """Path below which all lies that takes the key."""
        self._token: str | None = secrets.token_urlsafe(32)
        self._key: str | None = None
        self._cookie = f"pdcd-{port}"
        self._tickets: dict[str, str] = {}

    @property
    def address(self) -> str:
        """What is printed; good once."""
        return f"{self.origin}{ENTER}{self._token or ''}"

    def look(self, asked: Asked) -> None:
        """Refuse what is not of our own page, whoever sends it. Raises Refused."""
        if asked.one("host") != self.host:
            raise Refused(403, "another host is meant")
        if asked.method not in ("GET", "POST"):
            raise Refused(405, "only GET and POST")
        if not _PATH.fullmatch(asked.path) or _EMPTY_OR_DOTS.search(asked.path):
            raise Refused(404, "no such address")
        origin = asked.one("origin")
        if origin is not None and origin != self.origin:
            raise Refused(403, "another page asks")
        if (asked.one("sec-fetch-site") or "none") not in _PAGES:
            raise Refused(403, "another page asks")
        if "prefetch" in (asked.one("sec-purpose") or asked.one("purpose") or ""):
            raise Refused(403, "nobody asks yet")
        if asked.method == "POST":
            self._look_at_body(asked, origin)
        elif asked.one("content-length") not in (None, "0") or asked.all("transfer-encoding"):
            raise Refused(400, "a body is not expected")
        if asked.all("upgrade"):
            raise Refused(400, "no other protocol is spoken")

    def _look_at_body(self, asked: Asked, origin: str | None) -> None:
        if origin is None:
            raise Refused(403, "no page asks")
        if asked.one("content-type") != _JSON:
            raise Refused(415, f"only {_JSON}")
        if asked.all("content-encoding") or asked.all("transfer-encoding"):
            raise Refused(411, "the body comes with its length, as it is")
        length = asked.one("content-length") or ""
        if not re.fullmatch(r"[0-9]{1,9}", length):
            raise Refused(411, "the body comes with its length")

    def exchange(self, asked: Asked) -> str:
        """The cookie for the token in the path, as a header says it; the token is void then.

        Raises Refused.
        """
        given = asked.path.removeprefix(ENTER)
        if asked.method != "GET" or self._token is None or not _same(given, self._token):
            raise Refused(403, "this address is not good, or no more: start pdcd web again")
        self._token = None
        self._key = secrets.token_urlsafe(32)
        return f"{self._cookie}={self._key}; Path={self.room}/; HttpOnly; SameSite=Strict"

    def ticket(self, job: str) -> str:
        """An address at which the report of a run can be had without the key.

        A report may be anybody's page, so it must not learn where the page of the key lies: whoever
        listens at another port could have the cookie sent there.
        """
        ticket = secrets.token_urlsafe(24)
        self._tickets[ticket] = job
        while len(self._tickets) > MOST_TICKETS:
            del self._tickets[next(iter(self._tickets))]
        return f"{REPORT}{ticket}"

    def job_of(self, asked: Asked) -> str:
        """The run whose report is meant by a ticket. Raises Refused."""
        given = asked.path.removeprefix(REPORT)
        for ticket, job in self._tickets.items():
            if asked.method == "GET" and _same(given, ticket):
                return job
        raise Refused(404, "this address is no more: open the report from the page")

    def check(self, asked: Asked) -> None:
        """Refuse who has no key. Raises Refused."""
        if not asked.path.startswith(f"{self.room}/"):
            raise Refused(401, "open the address that pdcd web printed")
        try:
            cookie = SimpleCookie(asked.one("cookie") or "").get(self._cookie)
        except CookieError:
            cookie = None
        if cookie is None or self._key is None or not _same(cookie.value, self._key):
            raise Refused(401, "open the address that pdcd web printed")


def _same(given: str, wanted: str) -> bool:
    return secrets.compare_digest(given.encode(errors="replace"), wanted.encode())
