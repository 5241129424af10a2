"""Answers of the page beside the usual ones: the stream of news, refusals, and what went wrong."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
from aiohttp import web

from pdcd.web import app as module
from pdcd.web.asks import DaemonQueries
from pdcd.web.door import VisitorPlaces
from pdcd.web.news import News, TooManyPagesError
from tests.hostile.web_requests import Inside
from tests.hostile.web_trial import sent
from tests.unit.web.test_app import Daemon, asked, served


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Daemon:
    made = Daemon()
    monkeypatch.setattr(DaemonQueries, "_call", lambda *told: made.call(*told))
    return made


@pytest.mark.usefixtures("answers")
@pytest.mark.parametrize(
    "body",
    [
        b'{"goal": "\xff"}',
        b'{"goal": "white", "note": "' + b"\\ud800" * 3 + b'"}',
        b'{"goal": "white", "kernel": ' + b"[" * 4000 + b"]" * 4000 + b"}",
    ],
)
def test_a_body_that_breaks_the_decoder_is_a_bad_request(body: bytes, tmp_path: Path) -> None:
    async def scenario(host: str, port: int, inside: Inside) -> None:
        assert (await asked(host, port, inside, "plan", body))[0] == 400

    served(tmp_path, scenario)


@pytest.mark.usefixtures("answers")
def test_addresses_that_there_are_not_are_answered_in_one_line(tmp_path: Path) -> None:
    async def scenario(host: str, port: int, inside: Inside) -> None:
        for path, body, status in (("a/b/c/d", None, 404), ("runs", b"{}", 405)):
            found, headers, told = await asked(host, port, inside, path, body)
            assert found == status and json.loads(told)["error"]["kind"] == "refused"
            assert headers["content-security-policy"].startswith("default-src 'none'")

    served(tmp_path, scenario)


@pytest.mark.usefixtures("answers")
def test_refusals_are_logged_ever_more_seldom(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario(host: str, port: int, inside: Inside) -> None:
        for _ in range(12):
            assert (await asked(host, port, inside, "none.js"))[0] == 404

    served(tmp_path, scenario)
    told = [record.getMessage() for record in caplog.records if "refused=" in record.getMessage()]
    assert [line.split()[0] for line in told] == ["refused=1", "refused=10"]
    assert told[0] == "refused=1 requests so far, last status=404 why=no such address"


def stream(inside: Inside) -> bytes:
    who = f"host: {inside.host}\r\nauthorization: {inside.shown}"
    return f"GET /events HTTP/1.1\r\n{who}\r\n\r\n".encode()


@pytest.mark.usefixtures("answers")
def test_the_stream_of_news_has_no_end_and_tells_why_no_daemon_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[float | None] = []
    admit = VisitorPlaces.admit

    def noted(self: VisitorPlaces, transport: Any, seconds: float | None) -> None:
        given.append(seconds)
        admit(self, transport, seconds)

    monkeypatch.setattr(VisitorPlaces, "admit", noted)

    async def scenario(host: str, port: int, inside: Inside) -> None:
        given.clear()
        reader, writer = await asyncio.open_connection(host, port)
        writer.write(stream(inside))
        head = (await reader.readuntil(b"\r\n\r\n")).decode().lower()
        assert head.startswith("http/1.1 200")
        for line in (
            "content-type: text/event-stream", "cache-control: no-store", "connection: close",
            "content-security-policy: default-src 'none'", "x-frame-options: deny",
        ):  # fmt: skip
            assert f"\r\n{line}" in head
        text = b""
        while b"no daemon answers" not in text:
            text += await asyncio.wait_for(reader.read(1 << 16), 30.0)
        assert b'data: {"what":"state"' in text
        assert given == [30.0, None]
        writer.close()
        await writer.wait_closed()

    served(tmp_path, scenario)


@pytest.mark.usefixtures("answers")
def test_who_finds_no_place_for_news_is_told_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def page(self: News) -> AsyncGenerator[bytes, None]:
        raise TooManyPagesError
        yield b""

    monkeypatch.setattr(News, "page", page)

    async def scenario(host: str, port: int, inside: Inside) -> None:
        status, _, body = await asked(host, port, inside, "events")
        error = json.loads(body)["error"]
        assert (status, error["kind"], error["message"]) == (503, "busy", "too many pages are open")

    served(tmp_path, scenario)


@pytest.mark.usefixtures("answers")
@pytest.mark.parametrize(
    ("error", "ours"),
    [(ConnectionResetError(), False), (TimeoutError(), False), (ZeroDivisionError(), True)],
)
def test_a_page_that_goes_or_does_not_read_is_no_fault(
    error: Exception,
    ours: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def written(response: web.StreamResponse, data: bytes) -> None:
        raise error

    monkeypatch.setattr(module, "_written", written)

    async def scenario(host: str, port: int, inside: Inside) -> None:
        answer = await sent(host, port, stream(inside))
        assert answer.startswith(b"HTTP/1.1 200")
        assert ours or answer.count(b"HTTP/1.1") == 1

    served(tmp_path, scenario)
    assert ("fault of the program" in caplog.text) == ours
