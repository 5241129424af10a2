"""Hostile requests to the page: all refused, nothing done, the daemon as it was."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import pytest

from pdcd.web import guard
from pdcd.web.app import MOST_BYTES, SMALL_BYTES
from pdcd.web.door import ENTER
from pdcd.web.serve import bound, serving
from tests.e2e.server._server_harness import nothing_left
from tests.hostile.web_trial import exchanged, parted, sent, trial


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    with nothing_left():
        yield


def attacked(folder: Path, seed: int, count: int) -> None:
    outcome = asyncio.run(trial(folder, seed, count))
    assert not outcome.broken, "\n".join(outcome.broken[:5])
    assert sum(outcome.statuses.values()) == count
    assert {"400", "401", "403", "404", "405", "411", "413", "415"} <= outcome.statuses.keys()


def test_224_hostile_requests_are_refused(tmp_path: Path) -> None:
    attacked(tmp_path, 1, 224)


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


def test_who_says_nothing_or_comes_in_crowds_has_little_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guard, "STRANGER_S", 1.5)
    monkeypatch.setattr(guard, "STRANGERS", 4)

    async def scenario() -> None:
        sock = bound("127.0.0.1", 0)
        host, port = sock.getsockname()
        # No daemon is there, and the page is served.
        async with serving(sock, tmp_path / "none", tmp_path) as door:
            inside = await exchanged(host, port, door)
            who = f"host: {inside.host}\r\ncookie: {inside.cookie}"
            news = f"GET {inside.room}/events HTTP/1.1\r\n{who}\r\n\r\n"
            async with AsyncExitStack() as held:
                page = await held.enter_async_context(_opened(host, port, news.encode()))
                assert b'"here":false' in await page.readuntil(b"\n\n")
                half = b"GET / HTTP/1.1\r\nho"
                five = [await held.enter_async_context(_opened(host, port, half)) for _ in range(5)]
                assert all([await _cut(one) for one in five])
                # Who has the key stays, and there is room again.
                assert not page.at_eof()
            answer = await sent(host, port, b"GET / HTTP/1.1\r\nhost: x\r\n\r\n")
            assert answer.startswith(b"HTTP/1.1 403")

    asyncio.run(scenario())


def test_the_token_is_good_once_however_many_try(tmp_path: Path) -> None:
    async def scenario() -> list[bytes]:
        sock = bound("127.0.0.1", 0)
        host, port = sock.getsockname()
        async with serving(sock, tmp_path / "none", tmp_path) as door:
            path = door.address.partition(ENTER)[2]
            head = f"GET {ENTER}{path} HTTP/1.1\r\nhost: {door.host}\r\n\r\n".encode()
            return await asyncio.gather(*(sent(host, port, head) for _ in range(8)))

    before = threading.active_count()  # other tests may have left some that end by themselves
    answers = asyncio.run(scenario())
    assert sorted(answer[9:12] for answer in answers) == [b"303", *[b"403"] * 7]
    (good,) = (answer for answer in answers if answer[9:12] == b"303")
    for word in (b"HttpOnly", b"SameSite=Strict", b"Content-Security-Policy: default-src 'none'"):
        assert word in good
    assert threading.active_count() <= before


def test_a_body_that_is_too_long_is_not_waited_for(tmp_path: Path) -> None:
    async def scenario() -> None:
        sock = bound("127.0.0.1", 0)
        host, port = sock.getsockname()
        async with serving(sock, tmp_path / "none", tmp_path) as door:
            inside = await exchanged(host, port, door)
            for name, most in (("cancel", SMALL_BYTES), ("capture", MOST_BYTES)):
                for length, status in ((most + 1, b"413"), (10**9 - 1, b"413"), (2, b"400")):
                    head = (
                        f"POST {inside.room}/{name} HTTP/1.1\r\nhost: {inside.host}\r\n"
                        f"origin: http://{inside.host}\r\ncookie: {inside.cookie}\r\n"
                        f"content-type: application/json\r\ncontent-length: {length}\r\n\r\n"
                    )
                    answer = await sent(host, port, head.encode() + b"[]")
                    assert answer[9:12] == status

    asyncio.run(scenario())
