"""Hostile requests to the page: all refused, nothing done, the daemon as it was."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path

import pytest

from pdcd.web import door as module
from pdcd.web.app import MOST_BODY_BYTES, SMALL_BYTES
from pdcd.web.serve import bind_loopback, serve_page
from tests.e2e.server._server_harness import nothing_left
from tests.hostile.web_requests import Inside
from tests.hostile.web_trial import inside_of, parted, sent, trial


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    with nothing_left():
        yield


def attacked(folder: Path, seed: int, count: int) -> None:
    outcome = asyncio.run(trial(folder, seed, count))
    assert not outcome.broken, "\n".join(outcome.broken[:5])
    assert sum(outcome.statuses.values()) == count
    assert {"400", "401", "403", "404", "405", "411", "413"} <= outcome.statuses.keys()


def test_210_hostile_requests_are_refused(tmp_path: Path) -> None:
    attacked(tmp_path, 1, 210)


@pytest.mark.long
def test_10000_hostile_requests_are_refused(tmp_path: Path) -> None:
    attacked(tmp_path, 2, 10_000)


@asynccontextmanager
async def _opened(host: str, port: int, data: bytes) -> AsyncIterator[asyncio.StreamReader]:
    reader, writer = await asyncio.open_connection(host, port)
    try:
        writer.write(data)
        yield reader
    finally:
        await parted(writer)


async def _cut(reader: asyncio.StreamReader) -> bool:
    try:
        return await asyncio.wait_for(reader.read(), 10.0) == b""
    except ConnectionError:
        return True


def _head(inside: Inside, request: str, **more: str) -> bytes:
    """The head of a request with the token."""
    headers = {"host": inside.host, "authorization": inside.shown} | more
    lines = [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return "\r\n".join([f"{request} HTTP/1.1", *lines, "", ""]).encode()


def test_who_says_nothing_or_comes_in_crowds_keeps_nobody_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "STRANGERS", 4)

    async def scenario() -> None:
        sock = bind_loopback("127.0.0.1", 0)
        host, port = sock.getsockname()
        # No daemon is there, and the page is served.
        async with serve_page(sock, tmp_path / "none", tmp_path) as door:
            inside = inside_of(door)
            async with AsyncExitStack() as held:
                news = _head(inside, "GET /events")
                page = await held.enter_async_context(_opened(host, port, news))
                assert b'"here":false' in await page.readuntil(b"\n\n")
                half = b"GET / HTTP/1.1\r\nho"
                five = [await held.enter_async_context(_opened(host, port, half)) for _ in range(5)]
                # The first gives way to the last, and then to who has the token.
                assert await _cut(five[0])
                answer = await sent(host, port, _head(inside, "GET /runs"))
                assert answer.startswith(b"HTTP/1.1 200") and await _cut(five[1])
                monkeypatch.setattr(module, "STRANGER_S", 0.2)
                last = await held.enter_async_context(_opened(host, port, half))
                assert await _cut(last) and not page.at_eof()

    asyncio.run(scenario())


def test_strangers_who_come_back_at_once_sweep_nobody_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four times as many as there are places; a browser that takes its time is answered."""
    monkeypatch.setattr(module, "STRANGERS", 2)
    monkeypatch.setattr(module, "STAY_S", 0.3)

    async def keep(host: str, port: int) -> None:
        while True:
            with suppress(ConnectionError):
                async with _opened(host, port, b"") as reader:
                    await reader.read()

    async def scenario() -> None:
        sock = bind_loopback("127.0.0.1", 0)
        host, port = sock.getsockname()
        async with serve_page(sock, tmp_path / "none", tmp_path) as door:
            keepers = [asyncio.create_task(keep(host, port)) for _ in range(8)]
            wanted = _head(inside_of(door), "GET /runs")
            for _ in range(4):
                reader, writer = await asyncio.open_connection(host, port)
                await asyncio.sleep(0.02)
                writer.write(wanted)
                assert (await reader.read()).startswith(b"HTTP/1.1 200")
                await parted(writer)
            for keeper in keepers:
                keeper.cancel()
            await asyncio.gather(*keepers, return_exceptions=True)

    asyncio.run(scenario())


def test_no_request_has_the_token_in_its_address(tmp_path: Path) -> None:
    async def scenario() -> list[bytes]:
        sock = bind_loopback("127.0.0.1", 0)
        host, port = sock.getsockname()
        async with serve_page(sock, tmp_path / "none", tmp_path) as door:
            inside = inside_of(door)
            assert door.address == f"http://{host}:{port}/#{inside.token}"
            bare = f"host: {inside.host}\r\n\r\n".encode()
            lines = (b"GET /", b"GET /runs", f"GET /runs?{inside.token}".encode())
            return [await sent(host, port, line + b" HTTP/1.1\r\n" + bare) for line in lines]

    before = threading.active_count()  # other tests may have left some that end by themselves
    page, *others = asyncio.run(scenario())
    # The page itself has no secret: it opens nothing without what stands behind the #.
    assert page.startswith(b"HTTP/1.1 200") and b"Set-Cookie" not in page
    assert b"Content-Security-Policy: default-src 'none'" in page
    assert [answer[9:12] for answer in others] == [b"401", b"401"]
    assert threading.active_count() <= before


def test_a_body_that_is_too_long_is_not_waited_for(tmp_path: Path) -> None:
    async def scenario() -> None:
        sock = bind_loopback("127.0.0.1", 0)
        host, port = sock.getsockname()
        async with serve_page(sock, tmp_path / "none", tmp_path) as door:
            inside = inside_of(door)
            for name, most in (("cancel", SMALL_BYTES), ("capture", MOST_BODY_BYTES)):
                for length, status in ((most + 1, b"413"), (10**9 - 1, b"413"), (2, b"400")):
                    head = _head(inside, f"POST /{name}", content_length=str(length))
                    answer = await sent(host, port, head + b"[]")
                    assert answer[9:12] == status

    asyncio.run(scenario())
