"""Hostile requests to the page of `pdcd web`, as bytes: from strangers, and from pages of others
that make a browser send its cookie along. The same seed gives the same requests."""

from __future__ import annotations

import itertools
import json
import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

GETS = ("", "events", "describe", "runs", "main.js", "index.html")
POSTS = ("plan", "capture", "calibrate", "proceed", "cancel", "look")
TARGETS = ("/etc/passwd", "capture.json", "daemon.lock", "secret.png", "pdcd.sock", "main.js")
Value = str | list[str]
"""Of a header; a list comes as several."""
JOB = "20260101T120301Z-7f3a"


@dataclass(frozen=True)
class Inside:
    """All that an attacker might have learnt: everything. `cookie` stands in a request only where
    it is the browser that adds it."""

    host: str
    room: str
    cookie: str
    """Name and value, as a browser sends it."""
    token: str
    """The token that was exchanged, and is void."""


@dataclass(frozen=True)
class Attack:
    """One connection: a name for what it tries, and all that is sent."""

    name: str
    data: bytes


class _Maker:
    def __init__(self, inside: Inside, seed: int) -> None:
        self.inside = inside
        self.random = random.Random(seed)
        pictures = (f"picture/{JOB}/{name}/0" for name in ("secret", "pipe", "folder", "large"))
        traps = (f"{inside.room}/{path}" for path in (f"report/{JOB}", *pictures))
        self.traps = itertools.cycle(list(traps))

    def text(self, letters: str = "abcXYZ019-_", most: int = 50) -> str:
        return "".join(self.random.choices(letters, k=self.random.randint(1, most)))

    def head(
        self, method: str, path: str, more: Mapping[str, Value] = {}, *, skip: tuple[str, ...] = ()
    ) -> bytes:
        """A head that would be let in, but for `more`, and for what is skipped."""
        headers: dict[str, Value] = {
            "host": self.inside.host,
            "cookie": self.inside.cookie,
            "sec-fetch-site": "same-origin",
        }
        if method == "POST":
            headers["origin"] = f"http://{self.inside.host}"
            headers["content-type"] = "application/json"
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
            return "GET", f"{self.inside.room}/{self.random.choice(GETS)}"
        return "POST", f"{self.inside.room}/{self.random.choice(POSTS)}"

    def full(self, more: Mapping[str, Value]) -> bytes:
        method, path = self.address()
        return self.head(method, path, more) + (b"{}" if method == "POST" else b"")

    # Strangers.

    def no_key(self) -> bytes:
        method, path = self.address()
        return self.head(method, path, skip=("cookie",)) + b"{}" * (method == "POST")

    def wrong_key(self) -> bytes:
        name, _, key = self.inside.cookie.partition("=")
        at = self.random.randrange(len(key))
        other = "A" if key[at] != "A" else "B"
        wrong = self.random.choice(
            [
                key[:at] + other + key[at + 1 :],
                key[:at],
                key + "A",
                "",
                key.swapcase(),
                self.text(),
                "*",
            ]
        )
        cookie = self.random.choice(
            [f"{name}={wrong}", f"{name}x={key}", f"{name}={wrong}; other={key}", key, f"={key}"]
        )
        return self.full({"cookie": cookie})

    def two_cookies(self) -> bytes:
        return self.full({"cookie": [self.inside.cookie, self.inside.cookie]})

    def wrong_token(self) -> bytes:
        token = self.random.choice(
            [self.inside.token, self.text(), "", self.inside.token[:-1], "x" * 255]
        )
        method = self.random.choice(["GET", "GET", "POST"])
        return self.head(method, f"/enter/{token}", skip=("cookie",)) + b"{}" * (method == "POST")

    def other_room(self) -> bytes:
        ticket = f"/report/{self.random.choice(['', JOB, self.text(), self.inside.token])}"
        paths = ["/", "/main.js", "/capture", f"/{self.text()}/", self.inside.room, ticket]
        return self.head("GET", self.random.choice(paths))

    # Pages of others, in the browser that has the key.

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

    def foreign_origin(self) -> bytes:
        host, _, port = self.inside.host.rpartition(":")
        wrong: list[str | list[str]] = [
            "null", "http://evil.example", f"https://{self.inside.host}",
            f"http://localhost:{port}",
            f"http://{host}:1", f"http://{host}", f"http://{self.inside.host}.evil.example",
            f"http://{self.inside.host}/", f"http://evil.example#http://{self.inside.host}", "",
            "file://",
            [f"http://{self.inside.host}", "http://evil.example"],
        ]  # fmt: skip
        return self.full({"origin": self.random.choice(wrong)})

    def no_origin(self) -> bytes:
        path = f"{self.inside.room}/{self.random.choice(POSTS)}"
        return self.head("POST", path, skip=("origin", "sec-fetch-site")) + b"{}"

    def another_site(self) -> bytes:
        return self.full({"sec-fetch-site": self.random.choice(["cross-site", "same-site", "x"])})

    def a_form(self) -> bytes:
        kinds = ["text/plain", "application/x-www-form-urlencoded",
        "multipart/form-data; boundary=x",
                 "application/json; charset=utf-16", "",
                 "application/json, text/plain"]  # fmt: skip
        path = f"{self.inside.room}/{self.random.choice(POSTS)}"
        return self.head("POST", path, {"content-type": self.random.choice(kinds)}) + b"{}"

    def prefetched(self) -> bytes:
        return self.full({"sec-purpose": self.random.choice(["prefetch", "prefetch;prerender"])})

    def another_protocol(self) -> bytes:
        return self.head("GET", f"{self.inside.room}/events", {
            "connection": "Upgrade", "upgrade": self.random.choice(["websocket", "h2c"]),
            "sec-websocket-version": "13", "sec-websocket-key": "dGhlIHNhbXBsZSBub25jZQ==",
        })  # fmt: skip

    # Whoever has the key as well.

    def traversal(self) -> bytes:
        room, target = self.inside.room, self.random.choice(TARGETS)
        up = self.random.choice(
            ["..", "%2e%2e", "..%2f..", "%2e.", "..\\..", ".", "%c0%ae%c0%ae", "....//"]
        )
        depth = "/".join([up] * self.random.randint(1, 9))
        paths = [
            f"{room}/{depth}/{target}", f"{room}/picture/{depth}/{target}/0", f"/{depth}/{target}",
            f"{room}/picture/{JOB}/{depth}%2f{target}/0", f"{room}/report/{depth}/{target}",
            f"{room}/run/{depth}", f"{room}/report/{JOB}/{depth}/{target}", f"{room}//{target}",
            f"{room}/picture/{JOB}/{target}%00/0", f"{room}/report/%2f{target}",
            f"{room}/{target}%00.js",
            f"http://{self.inside.host}{room}/{depth}/{target}", f"{room}/main.js?{target}",
            f"{room}/main.js;{target}", f"{room}/{self.text()}.js", f"file://{target}",
            f"*{target}",
            f"{room}/picture/{JOB}/{self.text('ab.-_')}/0", f"{room}/run/{self.text()}",
            f"{room}/report/{JOB}.partial", f"{room}/report/captures", f"{room}/.hidden",
        ]  # fmt: skip
        return self.head("GET", self.random.choice(paths))

    def led_away(self) -> bytes:
        """Things on the disk that are not what they are called, one after the other."""
        return self.head("GET", next(self.traps))

    def huge_body(self) -> bytes:
        path = f"{self.inside.room}/{self.random.choice(POSTS)}"
        length = self.random.choice([2**20, 2**20 + 1, 2**31, 2**63, 10**9, 10**30])
        body = b" " * self.random.choice([0, 10, 5000, 200_000])
        return self.head("POST", path, {"content-length": str(length)}) + body

    def wrong_length(self) -> bytes:
        path = f"{self.inside.room}/{self.random.choice(POSTS)}"
        lengths: list[Value] = [
            "-1", "0x10", "+2", "1e3", "", "2, 2", ["2", "3"], ["2", "2"], "\u0662",
        ]  # fmt: skip
        length = self.random.choice(lengths)
        return self.head("POST", path, {"content-length": length}) + b"{}"

    def chunked(self) -> bytes:
        path = f"{self.inside.room}/{self.random.choice(POSTS)}"
        body = self.random.choice(
            [b"2\r\n{}\r\n0\r\n\r\n", b"fffffffff\r\n", b"-2\r\n{}\r\n", b"2;" + b"x" * 9000]
        )
        skip = self.random.choice([(), ("content-length",)])
        return self.head("POST", path, {"transfer-encoding": "chunked"}, skip=skip) + body

    def packed(self) -> bytes:
        path = f"{self.inside.room}/{self.random.choice(POSTS)}"
        coding = self.random.choice(["gzip", "br", "deflate"])
        return self.head("POST", path, {"content-encoding": coding}) + b"{}"

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
        return self.head("POST", f"{self.inside.room}/{name}", length) + body

    def unknown_job(self) -> bytes:
        body = json.dumps({"job": self.text("0123456789TZ-", 30)}).encode()
        path = f"{self.inside.room}/{self.random.choice(['cancel', 'proceed'])}"
        return self.head("POST", path, {"content-length": str(len(body))}) + body

    # No requests at all.

    def other_method(self) -> bytes:
        method = self.random.choice(
            ["PUT", "DELETE", "OPTIONS", "TRACE", "HEAD", "PATCH", "CONNECT", "get"]
        )
        _, path = self.address()
        return self.head(method, path)

    def body_of_get(self) -> bytes:
        return self.head("GET", f"{self.inside.room}/runs", {"content-length": "5"}) + b"hello"

    def long_head(self) -> bytes:
        which = self.random.randrange(4)
        if which == 0:
            return self.head(
                "GET", f"{self.inside.room}/" + "a" * self.random.choice([300, 2000, 70_000])
            )
        if which == 1:
            return self.full({"x": "y" * self.random.choice([5000, 70_000, 400_000])})
        if which == 2:
            many = self.random.choice([100, 3000])
            return self.full({f"x{number}": "y" for number in range(many)})
        return self.full({"cookie": self.inside.cookie + "; a=" + "b" * 5000})

    def smuggled(self) -> bytes:
        inner = (
            self.head("POST", f"{self.inside.room}/capture", {"content-length": "16"})
            + b'{"goal":"white"}'
        )
        runs, none = f"{self.inside.room}/runs", f"{self.inside.room}/none"
        both = {"content-length": "0", "transfer-encoding": "chunked"}
        outer = self.random.choice([
            self.head("POST", f"{self.inside.room}/cancel", both), self.head("GET", none),
            self.head("GET", runs, {"host": "evil.example"}),
            self.head("GET", runs, {"content-length": "0", "x": "a\n\nb"}),
            self.head("GET", none, {"transfer-encoding": " chunked"}),
            self.head("GET", none, {"x": "a\r\n folded"}),
        ])  # fmt: skip
        return outer + inner.replace(self.inside.cookie.encode(), b"none")

    def noise(self) -> bytes:
        return self.random.choice([
            self.random.randbytes(self.random.randint(1, 3000)) + b"\r\n\r\n",
            b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
            b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + self.random.randbytes(512),
            b"GET /\r\n\r\n",
            b"GET " + self.inside.room.encode() + b"/runs HTTP/1.0\r\n\r\n",
            b"GET / HTTP/9.9\r\nhost: x\r\n\r\n",
            b"\r\n" * 500,
            b"GET / HTTP/1.1\r\nhost : x\r\n\r\n",
            b"GET / HTTP/1.1\r\nhost: x\r\nbad header\r\n\r\n",
        ])  # fmt: skip


def attacks(inside: Inside, seed: int, count: int) -> Iterator[Attack]:
    """So many attacks, every kind as often as any other."""
    maker = _Maker(inside, seed)
    kinds: list[Callable[[], bytes]] = [
        maker.no_key, maker.wrong_key, maker.two_cookies, maker.wrong_token, maker.other_room,
        maker.foreign_host, maker.no_host, maker.foreign_origin, maker.no_origin,
        maker.another_site,
        maker.a_form, maker.prefetched, maker.another_protocol, maker.traversal, maker.traversal,
        maker.led_away, maker.huge_body, maker.wrong_length, maker.chunked, maker.packed,
        maker.wrong_body, maker.wrong_body, maker.unknown_job, maker.other_method,
        maker.body_of_get,
        maker.long_head, maker.smuggled, maker.noise,
    ]  # fmt: skip
    for number in range(count):
        kind = kinds[number % len(kinds)]
        yield Attack(kind.__name__, kind())
