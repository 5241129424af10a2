"""What each address of the page answers, asked of a server without a daemon behind it."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.errors import BusyError, ConfigError, DeniedError, DeviceLost, PdcdError, RequestError
from pdcd.protocol.about import GROUPS
from pdcd.protocol.request import CaptureRequest
from pdcd.web.app import LONG_S, SMALL_BYTES, WANTS
from pdcd.web.asks import ANSWER_S, ENGINE_S, DaemonQueries
from pdcd.web.door import REQUEST_S, VisitorPlaces
from pdcd.web.pages import read_page_files
from pdcd.web.serve import bind_loopback, serve_page
from tests.hostile.web_requests import Inside
from tests.hostile.web_trial import inside_of, sent
from tests.run_folders import finished, job
from tests.unit.cli.cli_stubs import PLAN

Scenario = Callable[[str, int, Inside], Awaitable[None]]


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


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> Daemon:
    made = Daemon()
    monkeypatch.setattr(DaemonQueries, "_call", lambda *told: made.call(*told))
    return made


def served(folder: Path, scenario: Scenario) -> None:
    async def body() -> None:
        sock = bind_loopback("127.0.0.1", 0)
        host, port = sock.getsockname()
        async with serve_page(sock, folder / "none", folder) as door:
            await scenario(host, port, inside_of(door))

    asyncio.run(body())


async def asked(host: str, port: int, inside: Inside, path: str, body: bytes | None = None) -> Any:
    """Status, headers and body of one answer."""
    method = "GET" if body is None else "POST"
    head = f"{method} /{path} HTTP/1.1\r\nhost: {inside.host}\r\n"
    if inside.token:
        head += f"authorization: {inside.shown}\r\n"
    if body is not None:
        head += f"content-length: {len(body)}\r\n"
    answer = await sent(host, port, f"{head}\r\n".encode() + (body or b""))
    lines, _, rest = answer.partition(b"\r\n\r\n")
    first, *more = lines.decode().split("\r\n")
    headers = {n.lower(): v for n, v in (line.split(": ", 1) for line in more)}
    return int(first.split()[1]), headers, rest


def test_files_of_the_page_are_served_by_their_kind(tmp_path: Path, daemon: Daemon) -> None:
    files = read_page_files()
    assert {kind for kind, _ in files.values()} >= {"text/html", "text/css", "text/javascript"}

    async def scenario(host: str, port: int, inside: Inside) -> None:
        for name in ("", *files):
            # A browser asks for them before it has the token; they hold no secret.
            status, headers, body = await asked(host, port, Inside(inside.host, ""), name)
            kind, data = files[name or "index.html"]
            assert (status, body) == (200, data)
            assert headers["content-type"] == f"{kind}; charset=utf-8"
        assert headers["cache-control"] == "no-store" and headers["server"] == "pdcd"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["content-security-policy"].startswith(
            "default-src 'none'; script-src 'self'"
        )
        assert headers["connection"] == "close"
        status, headers, body = await asked(host, port, inside, "none.js")
        assert status == 404 and json.loads(body)["error"]["kind"] == "refused"
        assert headers["x-frame-options"] == "DENY"

    served(tmp_path, scenario)


@pytest.mark.parametrize(
    ("name", "body", "method", "params", "answer_s"),
    [
        ("plan", {"goal": "white"}, "capture.plan", {"goal": "white"}, 60.0),
        ("capture", {"goal": "white"}, "capture.start", {"goal": "white", "detach": True}, 30.0),
        ("calibrate", {}, "calibrate.start", {"detach": True}, 30.0),
        ("proceed", {"job": "x"}, "calibrate.proceed", {"job": "x"}, 30.0),
        ("cancel", {"job": "x"}, "capture.cancel", {"job": "x"}, 60.0),
        ("look", {}, "preview.grab", {}, 60.0),
    ],
)
def test_a_wish_is_passed_on_as_the_daemon_takes_it(
    name: str, body: Any, method: str, params: Any, answer_s: float, tmp_path: Path, daemon: Daemon
) -> None:
    daemon.answers[method] = {"said": "yes"} if name != "plan" else msgspec.to_builtins(PLAN)

    async def scenario(host: str, port: int, inside: Inside) -> None:
        status, headers, answer = await asked(host, port, inside, name, json.dumps(body).encode())
        told = json.loads(answer)
        # A plan comes with its rows in words, as the command line has them.
        rows = dict(told.pop("rows", []))
        assert (status, told) == (200, json.loads(json.dumps(daemon.answers[method])))
        assert rows.get("codes") == ("8 hadamard, p = 0.5" if name == "plan" else None)
        assert headers["content-type"].startswith("application/json")

    served(tmp_path, scenario)
    told = [(each[0], each[1], each[2]) for each in daemon.asked if each[0] == method]
    (found,) = told
    assert params.items() <= dict(found[1]).items() and found[2] == WANTS[name].answer_s
    assert ("detach" in found[1]) == ("detach" in params)
    assert (answer_s == 60.0) == (found[2] == ENGINE_S)


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
def test_what_went_wrong_is_told_and_nothing_of_our_own_faults(
    error: Exception, status: int, tmp_path: Path, daemon: Daemon
) -> None:
    daemon.answers["capture.plan"] = error

    async def scenario(host: str, port: int, inside: Inside) -> None:
        found, headers, body = await asked(host, port, inside, "plan", b'{"goal": "white"}')
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

    served(tmp_path, scenario)


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
def test_a_body_that_is_no_wish_is_refused_unasked(
    body: bytes, says: str, tmp_path: Path, daemon: Daemon
) -> None:
    async def scenario(host: str, port: int, inside: Inside) -> None:
        status, _, answer = await asked(host, port, inside, "capture", body)
        assert status == 400 and says in json.loads(answer)["error"]["message"]
        long = b'{"job": "' + b"x" * (SMALL_BYTES - 11) + b'"}'
        assert len(long) == SMALL_BYTES
        assert (await asked(host, port, inside, "cancel", long))[0] != 413
        assert (await asked(host, port, inside, "cancel", long + b" "))[0] == 413

    served(tmp_path, scenario)
    assert not [each for each in daemon.asked if each[0] == "capture.start"]


def test_the_page_is_told_of_every_field_and_what_it_takes(tmp_path: Path, daemon: Daemon) -> None:
    daemon.answers["rig.describe"] = {"rig": {"grid": [3, 4]}, "goals": {}, "schema": {}}

    async def scenario(host: str, port: int, inside: Inside) -> None:
        status, _, body = await asked(host, port, inside, "describe")
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

    served(tmp_path, scenario)


def test_runs_pictures_and_reports_are_read_from_the_disk(tmp_path: Path, daemon: Daemon) -> None:
    place = finished(tmp_path / "captures", job(1))
    (place / "preview").mkdir()
    (place / "preview" / "indirect.png").write_bytes(b"png")
    (place / "report.html").write_text("<p>report")
    finished(tmp_path / "captures", job(2))

    async def scenario(host: str, port: int, inside: Inside) -> None:
        status, _, body = await asked(host, port, inside, "runs")
        told = [(run["job"], run["report"]) for run in json.loads(body)["runs"]]
        assert status == 200 and told == [(job(2), False), (job(1), True)]
        status, _, body = await asked(host, port, inside, f"run/{job(1)}")
        assert status == 200 and json.loads(body)["pictures"] == ["indirect"]
        status, headers, body = await asked(host, port, inside, f"picture/{job(1)}/indirect")
        assert (status, headers["content-type"], body) == (200, "image/png", b"png")
        assert (await asked(host, port, inside, f"picture/{job(1)}/none"))[0] == 400
        status, _, body = await asked(host, port, inside, f"ticket/{job(2)}")
        assert status == 404 and "no report" in body.decode()
        status, _, body = await asked(host, port, inside, f"ticket/{job(1)}")
        address = json.loads(body)["address"]
        assert status == 200 and inside.token not in address
        # The ticket needs no token, and what it shows is in a sandbox.
        bare = Inside(inside.host, "")
        status, headers, body = await asked(host, port, bare, address)
        assert (status, body) == (200, b"<p>report")
        policy = headers["content-security-policy"]
        assert policy.startswith("sandbox allow-scripts") and "'self'" not in policy
        assert headers["content-type"] == "text/html; charset=utf-8"
        assert (await asked(host, port, bare, address[:-1]))[0] == 404
        for path in ("runs", f"run/{job(1)}", "events", "describe", f"ticket/{job(1)}", "a/b/c"):
            assert (await asked(host, port, bare, path))[0] == 401
        assert (await asked(host, port, bare, "plan", b'{"goal": "white"}'))[0] == 401

    served(tmp_path, scenario)


def test_who_shows_the_token_has_more_time_and_who_waits_for_the_rig_most(
    tmp_path: Path, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[float | None] = []

    def admit(self: VisitorPlaces, transport: object, seconds: float | None) -> None:
        given.append(seconds)

    monkeypatch.setattr(VisitorPlaces, "admit", admit)

    async def scenario(host: str, port: int, inside: Inside) -> None:
        given.clear()
        await asked(host, port, inside, "runs")
        assert given == [REQUEST_S]
        await asked(host, port, inside, "look", b"{}")
        assert given == [REQUEST_S, REQUEST_S, LONG_S] and LONG_S > ENGINE_S > ANSWER_S

    served(tmp_path, scenario)


def test_the_end_waits_for_no_answer_of_a_daemon_that_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, free = threading.Event(), threading.Event()

    def hangs(*_: object) -> None:
        began.set()
        free.wait(120.0)

    monkeypatch.setattr(DaemonQueries, "_call", hangs)

    async def scenario() -> None:
        sock = bind_loopback("127.0.0.1", 0)
        host, port = sock.getsockname()
        async with serve_page(sock, tmp_path / "none", tmp_path) as door:
            look = asyncio.create_task(asked(host, port, inside_of(door), "look", b"{}"))
            await asyncio.to_thread(began.wait, 30.0)
        await asyncio.gather(look, return_exceptions=True)

    try:
        asyncio.run(asyncio.wait_for(scenario(), 30.0))
    finally:
        free.set()
