"""What the page is told of a stream, and how it has a run made of it."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator
from typing import Any

import pytest

from pdcd.errors import BusyError, ExposureError
from pdcd.web.asks import DaemonQueries
from tests.unit.web._page import Page, on_page
from tests.unit.web.test_web_live import messages


@on_page
async def test_the_job_is_told_first_then_pictures_then_the_end(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    async def follow(self: DaemonQueries, params: Any) -> AsyncGenerator[Any, None]:
        asked.append(params)
        yield {"job": "20260101T000000Z-abcd"}
        yield {"number": 1, "jpeg": "", "spoilt": ""}
        raise ExposureError("3 photos in a row were spoilt: late")

    monkeypatch.setattr(DaemonQueries, "follow_stream", follow)
    status, headers, body = await page.ask("stream", b'{"goal":"direct","codes":16,"over":2}')
    assert (status, headers["content-type"]) == (200, "text/event-stream")
    first, picture, end = messages(body)
    assert first["job"] and picture["number"] == 1 and "in a row" in end["error"]["message"]
    assert (asked[0]["goal"], asked[0]["codes"], asked[0]["over"]) == ("direct", 16, 2)


@on_page
async def test_what_is_no_stream_never_gets_to_the_daemon(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def follow(self: DaemonQueries, params: Any) -> AsyncGenerator[Any, None]:
        raise BusyError("the rig is taken")
        yield

    monkeypatch.setattr(DaemonQueries, "follow_stream", follow)
    status, _, body = await page.ask("stream", b'{"goal":"direct"}')
    assert (status, json.loads(body)["error"]["kind"]) == (409, "busy")
    for wrong in (b"{}", b'{"goal":"direct","over":0}', b'{"goal":"direct","more":1}', b"[]"):
        assert (await page.ask("stream", wrong))[0] == 400
    assert (await page.ask("stream", b'{"goal":"direct"}', bare=True))[0] == 401


@on_page
async def test_a_record_is_asked_of_the_daemon(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    async def ask(self: DaemonQueries, *given: Any, **more: Any) -> Any:
        asked.append(given)
        return {"job": "r", "state": "done", "folder": "/f"}

    monkeypatch.setattr(DaemonQueries, "ask", ask)
    status, _, body = await page.ask("record", b'{"job":"j"}')
    assert status == 200 and json.loads(body)["folder"] == "/f"
    assert asked == [("stream.record", {"job": "j"})]
