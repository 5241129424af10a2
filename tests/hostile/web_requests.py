"""Hostile requests to the page of `pdcd web`, as bytes: from strangers, from pages of others in the
same browser, and from whoever has the token. The same seed gives the same requests."""

from __future__ import annotations

import itertools
import json
import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

JOB = "20260101T120301Z-7f3a"
GETS = ("events", "describe", "runs", f"ticket/{JOB}", f"picture/{JOB}/direct")
POSTS = ("plan", "capture", "calibrate", "proceed", "cancel", "look")
TARGETS = ("/etc/passwd", "capture.json", "daemon.lock", "secret.png", "pdcd.sock")
Value = str | list[str]
"""Of a header; a list comes as several."""


@dataclass(frozen=True)
class Inside:
    """What lets in: the host that is to be named, and the token."""

    host: str
    token: str

    @property
    def shown(self) -> str:
        """The token as the page shows it."""
        return f"Bearer {self.token}"


@dataclass(frozen=True)
class Attack:
    """One connection: a name for what it tries, and all that is sent."""

    name: str
    data: bytes


class _Maker:
    def __init__(self, inside: Inside, seed: int) -> None:
        self.inside = inside
        self.random = random.Random(seed)
        pictures = (f"/picture/{JOB}/{name}" for name in ("secret", "pipe", "folder", "large"))
        self.traps = itertools.cycle([f"/ticket/{JOB}", f"/report/{JOB}/{'0' * 64}", *pictures])

    def text(self, letters: str = "abcXYZ019-_", most: int = 50) -> str:
        return "".join(self.random.choices(letters, k=self.random.randint(1, most)))

    def head(
        self, method: str, path: str, more: Mapping[str, Value] = {}, *, skip: tuple[str, ...] = ()
    ) -> bytes:
        """A head that would be let in, but for `more`, and for what is skipped."""
        headers: dict[str, Value] = {
            "host": self.inside.host,
            "authorization": self.inside.shown,
        }
        if method == "POST":
            headers["content-length"] = "2"
        headers |= more
        lines = [f"{method} {path} HTTP/1.1"]
        for name, value in headers.items():
            if name not in skip:
                lines += [
                    f"{name}: {each}" for each in (value if isinstance(value, list) else [value])
                ]
        return ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1", "replace")

    def address(self) -> tuple[str, str]:
        """A method and path that are served."""
        if self.random.random() < 0.5:
            return "GET", f"/{self.random.choice(GETS)}"
        return "POST", f"/{self.random.choice(POSTS)}"

    def full(self, more: Mapping[str, Value]) -> bytes:
        method, path = self.address()
        return self.head(method, path, more) + (b"{}" if method == "POST" else b"")

    # Strangers.

    def no_token(self) -> bytes:
        method, path = self.address()
        token = self.inside.token
        # In the wrong place it is none.
        more: Mapping[str, Value] = self.random.choice(
            [{}, {"cookie": f"token={token}"}, {"x-token": token}, {"proxy-authorization": token}]
        )
        path += self.random.choice(["", f"?token={token}", f"?{token}"])
        return self.head(method, path, more, skip=("authorization",)) + b"{}" * (method == "POST")

    def wrong_token(self) -> bytes:
        token = self.inside.token
        at = self.random.randrange(len(token))
        other = "A" if token[at] != "A" else "B"
        wrong: list[Value] = [
            f"Bearer {token[:at]}{other}{token[at + 1:]}", f"Bearer {token[:at]}", "Bearer ", "",
            f"Bearer {token}A", f"Bearer {token.swapcase()}", f"Basic {token}", token,
            f"bearer {token}", f"Bearer  {token}", f"Bearer {self.text()}", "Bearer \xff",
            [self.inside.shown] * 2, [self.inside.shown, "Bearer x"], ["x", self.inside.shown],
        ]  # fmt: skip
        return self.full({"authorization": self.random.choice(wrong)})

    def wrong_ticket(self) -> bytes:
        tickets = ["", self.text(), self.inside.token, "0" * 64, "%00", "x" * 300]
        return self.head("GET", f"/report/{JOB}/{self.random.choice(tickets)}")

    # Pages of others, in the browser that has the token: it shows it to nobody else's.

    def foreign_host(self) -> bytes:
        host, _, port = self.inside.host.rpartition(":")
        wrong: list[str | list[str]] = [
            "evil.example", f"evil.example:{port}", f"localhost:{port}", host, f"{host}:1",
            f"{host}.:{port}", f"{self.inside.host}.evil.example",
            f"{self.text()}@{self.inside.host}",
            "", f"0.0.0.0:{port}", f"[::1]:{port}", f"127.1:{port}", f"2130706433:{port}",
            [self.inside.host, "evil.example"], ["evil.example", self.inside.host],
        ]  # fmt: skip
        return self.full({"host": self.random.choice(wrong)})

    def no_host(self) -> bytes:
        method, path = self.address()
        return self.head(method, path, skip=("host",)) + b"{}" * (method == "POST")

    def foreign_page(self) -> bytes:
        origins = ["null", "http://evil.example", f"http://{self.inside.host}.evil.example", "x"]
        kinds = ["text/plain", "application/x-www-form-urlencoded", "application/json"]
        method, path = self.address()
        more = {
            "origin": self.random.choice(origins),
            "content-type": self.random.choice(kinds),
            "sec-fetch-site": self.random.choice(["cross-site", "same-site"]),
        }
        return self.head(method, path, more, skip=("authorization",)) + b"{}" * (method == "POST")

    # Whoever has the token as well.

    def traversal(self) -> bytes:
        target = self.random.choice(TARGETS)
        up = self.random.choice(
            ["..", "%2e%2e", "..%2f..", "%2e.", "..\\..", ".", "%c0%ae%c0%ae", "....//"]
        )
        depth = "/".join([up] * self.random.randint(1, 9))
        paths = [
            f"/{depth}/{target}", f"/picture/{depth}/{target}", f"/{depth}/{target}",
            f"/picture/{JOB}/{depth}%2f{target}", f"/report/{depth}/{target}",
            f"/run/{depth}", f"/report/{JOB}/{depth}/{target}", f"//{target}",
            f"/picture/{JOB}/{target}%00", f"/report/%2f{target}",
            f"/{target}%00.js",
            f"http://{self.inside.host}/{depth}/{target}",
            f"/main.js;{target}", f"/{self.text()}.js", f"file://{target}",
            f"*{target}",
            f"/picture/{JOB}/{self.text('ab.-_')}", f"/run/{self.text()}",
            f"/report/{JOB}.partial", "/report/captures", "/.hidden",
        ]  # fmt: skip
        return self.head("GET", self.random.choice(paths))

    def led_away(self) -> bytes:
        """Things on the disk that are not what they are called, one after the other."""
        return self.head("GET", next(self.traps))

    def huge_body(self) -> bytes:
        path = f"/{self.random.choice(POSTS)}"
        length = self.random.choice([2**20, 2**20 + 1, 2**31, 2**63, 10**9, 10**30])
        body = b" " * self.random.choice([0, 10, 5000, 200_000])
        return self.head("POST", path, {"content-length": str(length)}) + body

    def wrong_length(self) -> bytes:
        path = f"/{self.random.choice(POSTS)}"
        lengths: list[Value] = [
            "-1", "0x10", "+2", "1e3", "", "2, 2", ["2", "3"], ["2", "2"], "\u0662",
        ]  # fmt: skip
        length = self.random.choice(lengths)
        return self.head("POST", path, {"content-length": length}) + b"{}"

    def chunked(self) -> bytes:
        path = f"/{self.random.choice(POSTS)}"
        body = self.random.choice(
            [b"2\r\n{}\r\n0\r\n\r\n", b"fffffffff\r\n", b"-2\r\n{}\r\n", b"2;" + b"x" * 9000]
        )
        skip = self.random.choice([(), ("content-length",)])
        return self.head("POST", path, {"transfer-encoding": "chunked"}, skip=skip) + body

    def wrong_body(self) -> bytes:
        name = self.random.choice(POSTS)
        deep = 5000 if name in ("plan", "capture") else 1500
        values: list[object] = [
            [], 7, None, {"goal": "x" * 3000}, {"goal": "white", "gaol": 1}, {"job": "j" * 65},
            {"job": 7}, {"steps": ["focus", "rm -rf /"]}, {"goal": ["white"]}, {"attended": "yes"},
            {"goal": "white", "codes": 10**40}, {"goal": "white", "note": "n" * 4097},
            {"detach": True},
            {"goal": "white", "queue": True}, {"__proto__": {}}, {"goal": "white", "out": 1},
        ]  # fmt: skip
        body = self.random.choice([
            *(json.dumps(value).encode() for value in values), b"[" * deep, b'{"goal":' * 200,
            b"\xff\xfe",
            b'{"goal":"white"} {}', b'{"goal":"\xed\xa0\x80"}', b"", b"NaN",
            b'{"goal":"white","seed":NaN}',
        ])  # fmt: skip
        if body == b"" and name == "look":
            body = b"null"
        length = {"content-length": str(len(body))}
        return self.head("POST", f"/{name}", length) + body

    def unknown_job(self) -> bytes:
        body = json.dumps({"job": self.text("0123456789TZ-", 30)}).encode()
        path = f"/{self.random.choice(['cancel', 'proceed'])}"
        return self.head("POST", path, {"content-length": str(len(body))}) + body

    # No requests at all.

    def other_method(self) -> bytes:
        method = self.random.choice(
            ["PUT", "DELETE", "OPTIONS", "TRACE", "HEAD", "PATCH", "CONNECT", "get"]
        )
        _, path = self.address()
        return self.head(method, path)

    def long_head(self) -> bytes:
        which = self.random.randrange(4)
        if which == 0:
            return self.head("GET", "/" + "a" * self.random.choice([300, 2000, 70_000]))
        if which == 1:
            return self.full({"x": "y" * self.random.choice([5000, 70_000, 400_000])})
        if which == 2:
            many = self.random.choice([100, 3000])
            return self.full({f"x{number}": "y" for number in range(many)})
        return self.full({"authorization": self.inside.shown + "b" * 5000})

    def smuggled(self) -> bytes:
        inner = self.head("POST", "/capture", {"content-length": "16"}) + b'{"goal":"white"}'
        runs, none = "/runs", "/none"
        both = {"content-length": "0", "transfer-encoding": "chunked"}
        outer = self.random.choice([
            self.head("POST", "/cancel", both), self.head("GET", none),
            self.head("GET", runs, {"host": "evil.example"}),
            self.head("GET", runs, {"content-length": "0", "x": "a\n\nb"}),
            self.head("GET", none, {"transfer-encoding": " chunked"}),
            self.head("GET", none, {"x": "a\r\n folded"}),
        ])  # fmt: skip
        return outer + inner.replace(self.inside.token.encode(), b"none")

    def noise(self) -> bytes:
        return self.random.choice([
            self.random.randbytes(self.random.randint(1, 3000)) + b"\r\n\r\n",
            b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
            b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + self.random.randbytes(512),
            b"GET /\r\n\r\n",
            b"GET /runs HTTP/1.0\r\n\r\n",
            b"GET / HTTP/9.9\r\nhost: x\r\n\r\n",
            b"\r\n" * 500,
            b"GET / HTTP/1.1\r\nhost : x\r\n\r\n",
            b"GET / HTTP/1.1\r\nhost: x\r\nbad header\r\n\r\n",
        ])  # fmt: skip


def attacks(inside: Inside, seed: int, count: int) -> Iterator[Attack]:
    """So many attacks, every kind as often as any other."""
    maker = _Maker(inside, seed)
    kinds: list[Callable[[], bytes]] = [
        maker.no_token, maker.no_token, maker.wrong_token, maker.wrong_token, maker.wrong_ticket,
        maker.foreign_host, maker.no_host, maker.foreign_page, maker.traversal, maker.traversal,
        maker.led_away, maker.huge_body, maker.wrong_length, maker.chunked, maker.wrong_body,
        maker.wrong_body, maker.unknown_job, maker.other_method, maker.long_head, maker.smuggled,
        maker.noise,
    ]  # fmt: skip
    for number in range(count):
        kind = kinds[number % len(kinds)]
        yield Attack(kind.__name__, kind())
