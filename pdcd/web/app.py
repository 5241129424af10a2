"""The answers of each address of the page. Everything that the rig does is asked of the daemon."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any, get_args

import msgspec
from aiohttp import web

from pdcd.api.rows import plan_rows
from pdcd.client import INTAKE_TIMEOUT_S
from pdcd.errors import PdcdError, RequestError, to_error_fields
from pdcd.files.text import encode_json
from pdcd.printable import to_html
from pdcd.protocol.fields import FieldError, decode_struct
from pdcd.protocol.messages import MAX_LINE, JobParams, LiveParams, NoParams
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.stream import StreamRequest
from pdcd.web.asks import ENGINE_S, WAIT_S, DaemonQueries, Turns
from pdcd.web.door import REQUEST_S, BrowserAuth, Refusal, VisitorPlaces
from pdcd.web.news import News, TooManyPagesError, make_message
from pdcd.web.pages import (
    ALWAYS,
    INDEX,
    OURS,
    REPORTS,
    list_form_groups,
    name_fields,
    read_page_files,
)
from pdcd.web.shelf import RunShelf, ShelfRun
from pdcd.words import PatternName

logger = logging.getLogger(__name__)

MOST_BODY_BYTES = MAX_LINE - 4096
"""Longest body that asks for a photo; it must fit into a line to the daemon."""
SMALL_BYTES = 4096
"""Longest body of all other requests."""
LONG_S = ENGINE_S + INTAKE_TIMEOUT_S + WAIT_S
"""Longest time for a request that waits for the rig, in seconds."""
_WRITE_S = 10.0
"""How long a page may take to read what it is sent, in seconds."""
_DISK_AT_A_TIME = 4
"""Threads that read the disk."""

_STATUS: Mapping[str, int] = {"request": 400, "config": 400, "denied": 403, "busy": 409}
"""HTTP status by kind of error; 500 for all others."""

_ERROR_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>pdcd</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="stylesheet" href="/style.css">
<header><h1>pdcd</h1></header>
<main><section><h2>Nothing is at this address</h2><p>{}</p>
<p>Open the address that <code>pdcd web</code> printed last, all of it, with what stands behind
the #.</p></section></main></html>
"""

_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


@dataclass(frozen=True)
class _Wants:
    """What a POST asks of the daemon: method, parameters, and how long the answer may take."""

    params: type[msgspec.Struct]
    method: str
    answer_s: float
    most_bytes: int = SMALL_BYTES


WANTS: Mapping[str, _Wants] = {
    "plan": _Wants(CaptureRequest, "capture.plan", ENGINE_S, MOST_BODY_BYTES),
    "capture": _Wants(CaptureRequest, "capture.start", INTAKE_TIMEOUT_S, MOST_BODY_BYTES),
    "calibrate": _Wants(CalibrateRequest, "calibrate.start", INTAKE_TIMEOUT_S),
    "proceed": _Wants(JobParams, "calibrate.proceed", INTAKE_TIMEOUT_S),
    "cancel": _Wants(JobParams, "capture.cancel", ENGINE_S),
    "record": _Wants(JobParams, "stream.record", ENGINE_S),
    "look": _Wants(NoParams, "preview.grab", ENGINE_S),
}
"""Everything that a page can ask for, by the last part of the address."""
_DETACHED = ("capture", "calibrate")
"""Jobs that go on when the page is closed or this server ends; a page can still end them."""


class Site:
    """The addresses of one server."""

    def __init__(
        self,
        door: BrowserAuth,
        places: VisitorPlaces,
        asks: DaemonQueries,
        news: News,
        shelf: RunShelf,
    ) -> None:
        """places : those of the connections that bring requests."""
        self._places = places
        self._door = door
        self._asks = asks
        self._news = news
        self._shelf = shelf
        self._files = read_page_files()
        self._disk = Turns(_DISK_AT_A_TIME, "the disk")
        self._refusals = 0

    def app(self) -> web.Application:
        """The application that the server serves."""
        app = web.Application(middlewares=[self._keep], client_max_size=MOST_BODY_BYTES)
        for path, handler in (
            ("/", self._file),
            ("/events", self._events),
            ("/describe", self._describe),
            ("/runs", self._runs),
            ("/run/{job}", self._run),
            ("/picture/{job}/{name}", self._picture),
            ("/ticket/{job}", self._ticket),
            ("/report/{job}/{ticket}", self._report),
            ("/{name}", self._file),
        ):
            app.router.add_get(path, handler, allow_head=False)
        for name in WANTS:
            app.router.add_post(f"/{name}", self._post)
        app.router.add_post("/live", self._live)
        app.router.add_post("/stream", self._stream)
        return app

    @web.middleware
    async def _keep(self, request: web.Request, handler: _Handler) -> web.StreamResponse:
        """Let permitted requests in, and answer all others in one line."""
        try:
            response = await self._let_in(request, handler)
        except Refusal as no:
            response = self._refused(no.status, no.why)
        except web.HTTPException as err:
            response = self._refused(err.status, err.reason)
        except TooManyPagesError:
            response = _error(503, "busy", "too many pages are open")
        except PdcdError as err:
            status = _STATUS.get(err.kind, 500)
            response = _error(status, err.kind, err.message, err.device, err.hint)
        except ConnectionError as err:  # the client's Unreachable, or a browser that left
            response = _error(503, "unreachable", str(err))
        # Details of our own faults are not sent to whoever provoked them.
        except Exception:
            logger.exception("fault of the program path=%s", request.raw_path[:100])
            response = _error(500, "internal", "a fault of the program: see its log")
        seen = "text/html" in request.headers.get("Accept", "")
        if seen and response.status >= 400 and isinstance(response, web.Response):
            response = _error_page(response.status, response.text or "")
        if not response.prepared:
            for name, value in ALWAYS.items():
                response.headers[name] = value
            response.headers.setdefault("Content-Security-Policy", OURS)
            response.force_close()  # one request a connection: none can be smuggled in after it
        return response

    def _refused(self, status: int, why: str) -> web.Response:
        """The answer to a refused request; refusals are logged ever more rarely, so that nobody can
        fill the log."""
        self._refusals += 1
        if str(self._refusals).strip("0") == "1":
            logger.warning("refused=%d requests so far, last status=%d why=%s",
                           self._refusals, status, why)  # fmt: skip
        return _error(status, "refused", why)

    async def _let_in(self, request: web.Request, handler: _Handler) -> web.StreamResponse:
        self._door.check_host(request)
        # The files of the page hold no secret, and a browser asks for them before it has the token.
        if handler not in (self._file, self._report):
            self._door.check_token(request)
            self._places.admit(request.transport, REQUEST_S)
        return await handler(request)

    async def _file(self, request: web.Request) -> web.StreamResponse:
        found = self._files.get(request.match_info.get("name", INDEX))
        if found is None:
            raise Refusal(404, "no such address")
        kind, data = found
        return web.Response(body=data, content_type=kind, charset="utf-8")

    async def _events(self, request: web.Request) -> web.StreamResponse:
        return await self._streamed(request, self._news.page())

    async def _live(self, request: web.Request) -> web.StreamResponse:
        """Pictures of a live view; it ends when the page stops reading them."""
        asked = await _read_body(request, LiveParams, SMALL_BYTES)
        self._places.admit(request.transport, LONG_S)
        return await self._streamed(request, _tell_frames(self._asks.follow(_plain(asked))))

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        """Pictures of a stream; it ends when the page stops reading them."""
        asked = await _read_body(request, StreamRequest, MOST_BODY_BYTES)
        self._places.admit(request.transport, LONG_S)
        return await self._streamed(request, _tell_frames(self._asks.follow_stream(_plain(asked))))

    async def _streamed(
        self, request: web.Request, messages: AsyncGenerator[bytes, None]
    ) -> web.StreamResponse:
        """Server-sent events, until there are no more, or the page is gone."""
        async with contextlib.aclosing(messages):
            first = await anext(messages)
            response = web.StreamResponse(headers={**ALWAYS, "Content-Security-Policy": OURS})
            response.content_type = "text/event-stream"
            response.force_close()
            self._places.admit(request.transport, None)
            try:
                await response.prepare(request)
                await _written(response, first)
                async for data in messages:
                    await _written(response, data)
            except (ConnectionError, TimeoutError):
                pass  # the page is gone or does not read; it asks anew
            return response

    async def _describe(self, request: web.Request) -> web.StreamResponse:
        """The rig, the goals, and the fields of requests."""
        told = await self._asks.ask("rig.describe", answer_s=ENGINE_S)
        return _json(
            {
                "rig": told["rig"],
                "goals": told["goals"],
                "groups": list_form_groups(),
                "patterns": get_args(PatternName),
            }
        )

    async def _runs(self, request: web.Request) -> web.StreamResponse:
        found = await self._disk.do(self._shelf.runs)
        return _json({"runs": [_name_reason(run) for run in found]})

    async def _run(self, request: web.Request) -> web.StreamResponse:
        return _json(_name_reason(await self._disk.do(self._shelf.run, request.match_info["job"])))

    async def _picture(self, request: web.Request) -> web.StreamResponse:
        job, name = request.match_info["job"], request.match_info["name"]
        data = await self._disk.do(self._shelf.picture, job, name)
        return web.Response(body=data, content_type="image/png")

    async def _ticket(self, request: web.Request) -> web.StreamResponse:
        job = request.match_info["job"]
        if not (await self._disk.do(self._shelf.run, job)).report:
            raise Refusal(404, "that run has no report")
        return _json({"address": f"report/{job}/{self._door.ticket(job)}"})

    async def _report(self, request: web.Request) -> web.StreamResponse:
        """The report of a run, for a browser that has a ticket to it."""
        job = request.match_info["job"]
        self._door.check_ticket(job, request.match_info["ticket"])
        self._places.admit(request.transport, REQUEST_S)
        data = await self._disk.do(self._shelf.report, job)
        return web.Response(
            body=data,
            content_type="text/html",
            charset="utf-8",
            headers={"Content-Security-Policy": REPORTS},
        )

    async def _post(self, request: web.Request) -> web.StreamResponse:
        """Check a request and pass it on to the daemon."""
        name = request.path.rpartition("/")[2]
        wants = WANTS[name]
        asked = await _read_body(request, wants.params, wants.most_bytes)
        self._places.admit(request.transport, LONG_S)
        if isinstance(asked, JobParams) and name == "cancel":
            return _json(await self._asks.cancel(asked.job))
        params = _plain(asked)
        if name in _DETACHED:
            params["detach"] = True
        told = await self._asks.ask(wants.method, params, answer_s=wants.answer_s)
        if name == "plan":
            rows = plan_rows(msgspec.convert(told, PlanSummary))
            told = {**told, "rows": name_fields(rows)}
        return _json(told)


async def _read_body(
    request: web.Request, params: type[msgspec.Struct], most_bytes: int
) -> msgspec.Struct:
    """The request in a body, checked. Raises Refusal, RequestError."""
    if request.content_length is None:
        raise Refusal(411, "the body comes with its length")
    if request.content_length > most_bytes:
        raise Refusal(413, "the body is too long")
    body = await request.read()
    try:
        return decode_struct(body, params)
    except FieldError as err:
        raise RequestError(str(err)) from err
    except (ValueError, OverflowError, RecursionError) as err:
        raise Refusal(400, f"the body is not what it should be: {err}") from err


def _name_reason(run: ShelfRun) -> ShelfRun:
    """The run, with the reason of its failure in words of the page; text by people stays as it
    is."""
    if run.entry is None or run.entry.reason is None:
        return run
    entry = msgspec.structs.replace(run.entry, reason=name_fields(run.entry.reason))
    return msgspec.structs.replace(run, entry=entry)


def _plain(asked: msgspec.Struct) -> dict[str, Any]:
    plain: dict[str, Any] = msgspec.to_builtins(asked)
    return plain


async def _tell_frames(frames: AsyncGenerator[Any, None]) -> AsyncGenerator[bytes, None]:
    """A message for each picture, and a last one for the error that ended the live view."""
    begun = False
    async with contextlib.aclosing(frames):
        try:
            async for frame in frames:
                begun = True
                yield make_message(frame)
        except (PdcdError, ConnectionError) as err:
            if not begun:  # the status of the answer says it
                raise
            told = to_error_fields(err) if isinstance(err, PdcdError) else {"message": str(err)}
            yield make_message({"error": name_fields(told)})


async def _written(response: web.StreamResponse, data: bytes) -> None:
    async with asyncio.timeout(_WRITE_S):
        await response.write(data)


def _json(value: Any) -> web.Response:
    return web.Response(body=encode_json(value), content_type="application/json")


def _error(
    status: int, kind: str, message: str, device: str | None = None, hint: str | None = None
) -> web.Response:
    told = {"kind": kind, "message": message, "device": device, "hint": hint}
    response = _json({"error": name_fields(told)})
    response.set_status(status)
    return response


def _error_page(status: int, told: str) -> web.Response:
    """The same as a page, for a person who typed an address or kept an old one."""
    page = _ERROR_PAGE.format(to_html(msgspec.json.decode(told)["error"]["message"]))
    return web.Response(text=page, status=status, content_type="text/html", charset="utf-8")
