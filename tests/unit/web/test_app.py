"""What each address of the page answers, asked of a server without a daemon behind it."""

from __future__ import annotations

import asyncio
import json
import shutil
import threading
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from aiohttp import web

from pdcd.errors import BusyError, ConfigError, DeniedError, DeviceLost, PdcdError, RequestError
from pdcd.protocol.about import GROUPS
from pdcd.protocol.request import CaptureRequest
from pdcd.web import app as module
from pdcd.web.app import LONG_S, SMALL_BYTES
from pdcd.web.asks import ANSWER_S, ENGINE_S, DaemonQueries
from pdcd.web.door import REQUEST_S, VisitorPlaces
from pdcd.web.news import News, TooManyPagesError
from pdcd.web.pages import read_page_files
from tests.run_folders import cut, finished, job
from tests.unit.cli.cli_stubs import PLAN
from tests.unit.web._page import Daemon, Page, on_page, open_page


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> Daemon:
    made = Daemon()
    monkeypatch.setattr(DaemonQueries, "_call", lambda *told: made.call(*told))
    return made


@on_page
async def test_files_of_the_page_are_served_by_their_kind(page: Page, daemon: Daemon) -> None:
    files = read_page_files()
    assert {kind for kind, _ in files.values()} >= {"text/html", "text/css", "text/javascript"}

    for name in ("", *files):
        # A browser asks for them before it has the token; they hold no secret.
        status, headers, body = await page.ask(name, bare=True)
        kind, data = files[name or "index.html"]
        assert (status, body) == (200, data)
        assert headers["content-type"] == f"{kind}; charset=utf-8"
    assert headers["cache-control"] == "no-store" and headers["server"] == "pdcd"
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'")
    assert headers["connection"] == "close"
    status, headers, body = await page.ask("none.js")
    assert status == 404 and json.loads(body)["error"]["kind"] == "refused"
    assert headers["x-frame-options"] == "DENY"


@pytest.mark.parametrize(
    ("name", "body", "method", "params"),
    [
        ("plan", {"goal": "white"}, "capture.plan", {"goal": "white"}),
        ("capture", {"goal": "white"}, "capture.start", {"goal": "white", "detach": True}),
        ("calibrate", {}, "calibrate.start", {"detach": True}),
        ("proceed", {"job": "x"}, "calibrate.proceed", {"job": "x"}),
        ("cancel", {"job": "x"}, "capture.cancel", {"job": "x"}),
        ("look", {}, "preview.grab", {}),
    ],
)
@on_page
async def test_a_wish_is_passed_on_as_the_daemon_takes_it(
    page: Page, name: str, body: Any, method: str, params: Any, daemon: Daemon
) -> None:
    daemon.answers[method] = {"said": "yes"} if name != "plan" else msgspec.to_builtins(PLAN)

    status, headers, answer = await page.ask(name, json.dumps(body).encode())
    told = json.loads(answer)
    # A plan comes with its rows in words, as the command line has them.
    rows = dict(told.pop("rows", []))
    assert (status, told) == (200, json.loads(json.dumps(daemon.answers[method])))
    assert rows.get("codes") == ("8 hadamard, p = 0.5" if name == "plan" else None)
    assert headers["content-type"].startswith("application/json")
    ((_, sent, answer_s),) = [each for each in daemon.asked if each[0] == method]
    assert params.items() <= dict(sent).items() and ("detach" in sent) == ("detach" in params)
    # What needs the devices, or the end of a job, is waited for longest.
    assert (answer_s == ENGINE_S) == (name in ("plan", "cancel", "look"))


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (RequestError("no such goal", hint="take white"), 400),
        (ConfigError("no such scene"), 400),
        (DeniedError("who looks on plans nothing"), 403),
        (BusyError("somebody else works"), 409),
        (DeviceLost("unplugged", device="camera"), 500),
        (ConnectionRefusedError("no daemon answers"), 503),
        (ZeroDivisionError("a secret of ours"), 500),
    ],
)
@on_page
async def test_what_went_wrong_is_told_and_nothing_of_our_own_faults(
    page: Page, error: Exception, status: int, daemon: Daemon
) -> None:
    daemon.answers["capture.plan"] = error

    found, headers, body = await page.ask("plan", b'{"goal": "white"}')
    told = json.loads(body)["error"]
    assert found == status and headers["referrer-policy"] == "no-referrer"
    if isinstance(error, PdcdError):
        assert told == {
            "kind": error.kind, "message": error.message, "device": error.device,
            "hint": error.hint,
        }  # fmt: skip
    elif status == 503:
        assert (told["kind"], told["message"]) == ("unreachable", "no daemon answers")
    else:
        assert told["kind"] == "internal" and "secret" not in body.decode()


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (b"", "the body is not what it should be"),
        (b"{", "the body is not what it should be"),
        (b"[]", "the body is not what it should be"),
        (b'{"goal": "white", "gaol": 1}', "the body is not what it should be"),
        (b'{"goal": 1}', "goal: it takes white, "),
        (b'{"goal": "white", "codes": 0}', "codes: it takes a whole number from 1 to 65536, not 0"),
    ],
)
@on_page
async def test_a_body_that_is_no_wish_is_refused_unasked(
    page: Page, body: bytes, says: str, daemon: Daemon
) -> None:
    status, _, answer = await page.ask("capture", body)
    assert status == 400 and says in json.loads(answer)["error"]["message"]
    long = b'{"job": "' + b"x" * (SMALL_BYTES - 11) + b'"}'
    assert len(long) == SMALL_BYTES
    assert (await page.ask("cancel", long))[0] != 413
    assert (await page.ask("cancel", long + b" "))[0] == 413
    assert not [each for each in daemon.asked if each[0] == "capture.start"]


@on_page
async def test_the_page_is_told_of_every_field_and_what_it_takes(
    page: Page, daemon: Daemon
) -> None:
    daemon.answers["rig.describe"] = {"rig": {"grid": [3, 4]}, "goals": {}, "schema": {}}

    status, _, body = await page.ask("describe")
    told = json.loads(body)
    assert status == 200 and told["rig"]["grid"] == [3, 4]
    fields = {field["name"]: field for group in told["groups"] for field in group["fields"]}
    assert told["groups"][0]["title"] == GROUPS["goal"][0]
    assert {"goal", *fields} == set(CaptureRequest.__struct_fields__)
    assert fields["codes"]["takes"] == "a whole number from 1 to 65536"
    assert fields["parts"]["values"] == ["auto"] and fields["parts"]["kind"] == "number"
    assert fields["guards"]["values"][:3] == [True, False, "none"]
    assert fields["plane"]["count"] == 9 and fields["white"]["default"] is True
    assert fields["p"]["of_goals"] and not fields["codes"]["of_goals"]


@on_page
async def test_runs_pictures_and_reports_are_read_from_the_disk(
    page: Page, tmp_path: Path, daemon: Daemon
) -> None:
    place = finished(tmp_path / "captures", job(1))
    (place / "preview").mkdir()
    (place / "preview" / "indirect.png").write_bytes(b"png")
    (place / "report.html").write_text("<p>report")
    finished(tmp_path / "captures", job(2))

    noted = "what --parts 4 did"
    cut(tmp_path / "captures", job(3), {"event": "failed", "message": "take --parts 4"}, note=noted)
    status, _, body = await page.ask("runs")
    last = json.loads(body)["runs"].pop(0)["entry"]
    assert (last["reason"], last["note"]) == ("take parts 4", noted)
    shutil.rmtree(tmp_path / "captures" / f"{job(3)}.partial")
    status, _, body = await page.ask("runs")
    told = [(run["job"], run["report"]) for run in json.loads(body)["runs"]]
    assert status == 200 and told == [(job(2), False), (job(1), True)]
    status, _, body = await page.ask(f"run/{job(1)}")
    assert status == 200 and json.loads(body)["pictures"] == ["indirect"]
    status, headers, body = await page.ask(f"picture/{job(1)}/indirect")
    assert (status, headers["content-type"], body) == (200, "image/png", b"png")
    assert (await page.ask(f"picture/{job(1)}/none"))[0] == 400
    status, _, body = await page.ask(f"picture/{job(1)}/none", accept="text/html")
    assert status == 400 and b"<html" in body and b"{" not in body  # a person reads it
    status, _, body = await page.ask(f"ticket/{job(2)}")
    assert status == 404 and "no report" in body.decode()
    status, _, body = await page.ask(f"ticket/{job(1)}")
    address = json.loads(body)["address"]
    assert status == 200 and page.inside.token not in address
    # The ticket needs no token, and what it shows is in a sandbox.
    status, headers, body = await page.ask(address, bare=True)
    assert (status, body) == (200, b"<p>report")
    policy = headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts") and "'self'" not in policy
    assert headers["content-type"] == "text/html; charset=utf-8"
    assert (await page.ask(address[:-1], bare=True))[0] == 404
    for path in ("runs", f"run/{job(1)}", "events", "describe", f"ticket/{job(1)}", "a/b/c"):
        assert (await page.ask(path, bare=True))[0] == 401
    assert (await page.ask("plan", b'{"goal": "white"}', bare=True))[0] == 401


@on_page
async def test_who_shows_the_token_has_more_time_and_who_waits_for_the_rig_most(
    page: Page, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[float | None] = []

    def admit(self: VisitorPlaces, transport: object, seconds: float | None) -> None:
        given.append(seconds)

    monkeypatch.setattr(VisitorPlaces, "admit", admit)

    given.clear()
    await page.ask("runs")
    assert given == [REQUEST_S]
    await page.ask("look", b"{}")
    assert given == [REQUEST_S, REQUEST_S, LONG_S] and LONG_S > ENGINE_S > ANSWER_S


async def test_the_end_waits_for_no_answer_of_a_daemon_that_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, free = threading.Event(), threading.Event()

    def hangs(*_: object) -> None:
        began.set()
        free.wait(120.0)

    monkeypatch.setattr(DaemonQueries, "_call", hangs)
    try:
        async with asyncio.timeout(30.0):
            async with open_page(tmp_path) as page:
                look = asyncio.create_task(page.ask("look", b"{}"))
                await asyncio.to_thread(began.wait, 30.0)
            await asyncio.gather(look, return_exceptions=True)
    finally:
        free.set()


@pytest.mark.usefixtures("daemon")
@pytest.mark.parametrize(
    "body",
    [
        b'{"goal": "\xff"}',
        b'{"goal": "white", "note": "' + b"\\ud800" * 3 + b'"}',
        b'{"goal": "white", "kernel": ' + b"[" * 4000 + b"]" * 4000 + b"}",
    ],
)
@on_page
async def test_a_body_that_breaks_the_decoder_is_a_bad_request(page: Page, body: bytes) -> None:
    assert (await page.ask("plan", body))[0] == 400


@pytest.mark.usefixtures("daemon")
@on_page
async def test_addresses_that_there_are_not_are_answered_in_one_line(page: Page) -> None:
    for path, body, status in (("a/b/c/d", None, 404), ("runs", b"{}", 405)):
        found, headers, told = await page.ask(path, body)
        assert found == status and json.loads(told)["error"]["kind"] == "refused"
        assert headers["content-security-policy"].startswith("default-src 'none'")


@pytest.mark.usefixtures("daemon")
@on_page
async def test_refusals_are_logged_ever_more_seldom(
    page: Page, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(12):
        assert (await page.ask("none.js"))[0] == 404
    told = [record.getMessage() for record in caplog.records if "refused=" in record.getMessage()]
    assert [line.split()[0] for line in told] == ["refused=1", "refused=10"]
    assert told[0] == "refused=1 requests so far, last status=404 why=no such address"


def stream(page: Page) -> bytes:
    who = f"host: {page.inside.host}\r\nauthorization: {page.inside.shown}"
    return f"GET /events HTTP/1.1\r\n{who}\r\n\r\n".encode()


@pytest.mark.usefixtures("daemon")
@on_page
async def test_the_stream_of_news_has_no_end_and_tells_why_no_daemon_is_there(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[float | None] = []
    admit = VisitorPlaces.admit

    def noted(self: VisitorPlaces, transport: Any, seconds: float | None) -> None:
        given.append(seconds)
        admit(self, transport, seconds)

    monkeypatch.setattr(VisitorPlaces, "admit", noted)

    given.clear()
    reader, writer = await asyncio.open_connection(page.host, page.port)
    writer.write(stream(page))
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


@pytest.mark.usefixtures("daemon")
@on_page
async def test_who_finds_no_place_for_news_is_told_so(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def refuse(self: News) -> AsyncGenerator[bytes, None]:
        raise TooManyPagesError
        yield b""

    monkeypatch.setattr(News, "page", refuse)

    status, _, body = await page.ask("events")
    error = json.loads(body)["error"]
    assert (status, error["kind"], error["message"]) == (503, "busy", "too many pages are open")


@pytest.mark.usefixtures("daemon")
@pytest.mark.parametrize(
    ("error", "ours"),
    [(ConnectionResetError(), False), (TimeoutError(), False), (ZeroDivisionError(), True)],
)
@on_page
async def test_a_page_that_goes_or_does_not_read_is_no_fault(
    page: Page,
    error: Exception,
    ours: bool,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def written(response: web.StreamResponse, data: bytes) -> None:
        raise error

    monkeypatch.setattr(module, "_written", written)

    answer = await page.send(stream(page))
    assert answer.startswith(b"HTTP/1.1 200")
    assert ours or answer.count(b"HTTP/1.1") == 1
    assert ("fault of the program" in caplog.text) == ours
