"""The page of `pdcd web` without a daemon behind it, and a client that asks it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pdcd.web.asks import DaemonQueries
from pdcd.web.serve import bind_loopback, serve_page
from tests.coroutines import entered
from tests.hostile.web_requests import Inside
from tests.hostile.web_trial import inside_of, sent


class Daemon:
    """Answers of a daemon by method, or what it raises, and what it was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Any, float]] = []
        self.answers: dict[str, Any] = {}

    def call(self, asks: DaemonQueries, method: str, params: Any, answer_s: float) -> Any:
        self.asked.append((method, params, answer_s))
        answer = self.answers.get(method, {"state": "idle"})
        if isinstance(answer, BaseException):
            raise answer
        return answer


@dataclass
class Page:
    """Where it is served, and what lets in."""

    host: str
    port: int
    inside: Inside

    async def send(self, data: bytes) -> bytes:
        """All that comes back for these bytes, however long the page takes: it takes who sends no
        more for somebody who has left, and drops the answer."""
        return await sent(self.host, self.port, data, quiet_s=None)

    async def ask(
        self, path: str, body: bytes | None = None, *, bare: bool = False, accept: str = "*/*"
    ) -> Any:
        """Status, headers and body of one answer; asked without the token where `bare`."""
        method = "GET" if body is None else "POST"
        head = f"{method} /{path} HTTP/1.1\r\nhost: {self.inside.host}\r\n"
        head += f"accept: {accept}\r\n"
        if not bare:
            head += f"authorization: {self.inside.shown}\r\n"
        if body is not None:
            head += f"content-length: {len(body)}\r\n"
        answer = await self.send(f"{head}\r\n".encode() + (body or b""))
        lines, _, rest = answer.partition(b"\r\n\r\n")
        first, *more = lines.decode().split("\r\n")
        headers = {n.lower(): v for n, v in (line.split(": ", 1) for line in more)}
        return int(first.split()[1]), headers, rest


@asynccontextmanager
async def open_page(tmp_path: Path) -> AsyncIterator[Page]:
    sock = bind_loopback("127.0.0.1", 0)
    host, port = sock.getsockname()
    async with serve_page(sock, tmp_path / "none", tmp_path) as door:
        yield Page(host, port, inside_of(door))


on_page = entered(page=open_page)
"""Runs a coroutine test with a page of its own, its parameter `page`."""
