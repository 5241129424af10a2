"""What the page is told of a live view, of wrong addresses, and in words of its own."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest

from pdcd.errors import BusyError, DeviceLost, PdcdError
from pdcd.web.asks import DaemonQueries
from pdcd.web.pages import list_form_groups, name_fields
from tests.unit.web._page import Page, on_page


def follow_with(monkeypatch: pytest.MonkeyPatch, frames: int, error: PdcdError | None) -> list[Any]:
    """Have the daemon give so many pictures and then that error; the list is what it was asked."""
    asked: list[Any] = []

    async def follow(self: DaemonQueries, params: Any) -> AsyncGenerator[Any, None]:
        asked.append(params)
        try:
            for number in range(1, frames + 1):
                yield {"number": number}
            if error is not None:
                raise error
        finally:
            asked.append("closed")

    monkeypatch.setattr(DaemonQueries, "follow", follow)
    return asked


def messages(body: bytes) -> list[Any]:
    """The server-sent events of a chunked body."""
    found = []
    for line in body.decode().splitlines():
        if line.startswith("data: "):
            found.append(json.loads(line.removeprefix("data: ")))
    return found


@on_page
async def test_pictures_are_told_one_by_one_and_then_the_end(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = DeviceLost("it went", device="camera", hint="plug it in")
    asked = follow_with(monkeypatch, 3, lost)
    status, headers, body = await page.ask("live", b'{"pattern":"star"}')
    assert (status, headers["content-type"]) == (200, "text/event-stream")
    *frames, end = messages(body)
    assert [frame["number"] for frame in frames] == [1, 2, 3]
    assert end["error"]["message"] == "it went" and end["error"]["hint"] == "plug it in"
    assert asked == [{"pattern": "star", "index": 0}, "closed"]


@on_page
async def test_one_that_does_not_begin_is_refused_by_status(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    follow_with(monkeypatch, 0, BusyError("the rig is taken"))
    status, _, body = await page.ask("live", b"{}")
    assert (status, json.loads(body)["error"]["kind"]) == (409, "busy")
    for wrong in (b'{"pattern":"flash"}', b'{"more":1}', b"[]"):
        assert (await page.ask("live", wrong))[0] == 400
    assert (await page.ask("live", b"{}", bare=True))[0] == 401
    assert (await page.ask("live", b" " * 5000))[0] == 413


@pytest.mark.parametrize("path", ["none", "run/nothing", "report/x/y", "events"])
@on_page
async def test_a_wrong_address_is_told_of_in_words_to_a_person(page: Page, path: str) -> None:
    answer = await page.send(
        f"GET /{path} HTTP/1.1\r\nhost: {page.inside.host}\r\naccept: text/html\r\n\r\n".encode()
    )
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.split()[1] in (b"401", b"404") and b"text/html" in head
    assert b"Content-Security-Policy: default-src" in head
    assert b"the address that <code>pdcd web</code> printed" in body and b"{" not in body


class Daemon:
    """Stands for the daemon's end of a client."""

    closed = 0

    def __init__(self, *_: object) -> None:
        """Nothing is met."""

    def call(self, method: str, params: Any) -> dict[str, Any]:
        return {"job": f"{method} {params['goal']}"}

    def answer(self, method: str, asked: Any, timeout_s: float | None) -> dict[str, Any]:
        return {"number": asked["after"] + 1, "of": asked["job"], "by": method}

    def close(self) -> None:
        Daemon.closed += 1


@on_page
async def test_a_stream_tells_its_job_before_its_pictures_and_a_live_view_does_not(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pdcd.web.asks.Client", Daemon)
    asks = DaemonQueries(Path("nowhere"))
    for follow, start, see in (
        (asks.follow, "preview.live", "preview.frame"),
        (asks.follow_stream, "stream.start", "stream.frame"),
    ):
        closed, pictures, found = Daemon.closed, follow({"goal": "g"}), list[Any]()
        async for one in pictures:
            found.append(one)
            if one.get("number") == 2:
                break
        await pictures.aclose()
        job = f"{start} g"
        frames = [{"number": number, "of": job, "by": see} for number in (1, 2)]
        assert found == ([{"job": job}, *frames] if start == "stream.start" else frames)
        assert Daemon.closed == closed + 1


def test_advice_speaks_of_fields_as_the_form_calls_them() -> None:
    told = {"hint": "take --parts 4, or --exposure 3 (--until-error)", "n": 4, "all": ["--anew"]}
    assert name_fields(told) == {
        "hint": "take parts 4, or exposure 3 (until error)", "n": 4, "all": ["--anew"],
    }  # fmt: skip
    assert name_fields("a--parts and ---parts and -- parts") == "a--parts and ---parts and -- parts"


def test_labels_say_units() -> None:
    labels = {f["name"]: f["label"] for group in list_form_groups() for f in group["fields"]}
    assert labels["exposure_s"] == "exposure (s)" and labels["radius"] == "radius (cells)"
    assert labels["error"] == "error (share of 1)" and labels["seconds"] == "seconds"
    assert labels["codes"] == "codes" and labels["shift"] == "shift (cells)"
