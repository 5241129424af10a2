"""Every message of the socket as a value, and the table of methods.

The wire format is JSON-RPC 2.0, one object a line (https://www.jsonrpc.org/specification).
Parameters refuse unknown fields, so that a misspelt one is not silently ignored. Messages of the
server may gain fields, and clients ignore fields that they do not know.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from pdcd.bench.tables import Config
from pdcd.errors import KINDS, PdcdError, ProtocolError, make_error
from pdcd.protocol import events
from pdcd.protocol.entry import Page, RunQuery
from pdcd.protocol.plan_summary import PlanSummary
from pdcd.protocol.request import CalibrateRequest, CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.stream import StreamFrame, StreamRequest
from pdcd.protocol.views import ClientRole, LiveFrame, OwnerView, PreviewView, RigView
from pdcd.words import JobKind, JobState, PatternName

_T = TypeVar("_T")

PROTOCOL = (1, 0)
"""Major and minor version: a major change breaks clients, a minor one only adds."""

MAX_LINE = 2**20
"""Longest line in either direction, in bytes, its newline included."""

MAX_FDS = 16
"""Most descriptors that one connection may have sent without naming them in a request, and most
that its unanswered requests may hold."""

PARSE_ERROR, _INVALID_REQUEST, METHOD_NOT_FOUND, _INVALID_PARAMS, _INTERNAL_ERROR = (
    -32700,
    -32600,
    -32601,
    -32602,
    -32603,
)
"""The codes that JSON-RPC 2.0 reserves (section 5.1)."""

CODES: Mapping[str, int] = MappingProxyType(
    {
        "protocol": _INVALID_REQUEST,
        "config": _INVALID_PARAMS,
        "request": _INVALID_PARAMS,
        "internal": _INTERNAL_ERROR,
        # The range left to applications; the order is frozen, new kinds go to the end.
        "busy": -32001,
        "cancelled": -32002,
        "device_lost": -32003,
        "driver_unavailable": -32004,
        "sync": -32005,
        "exposure": -32006,
        "decode": -32007,
        "no_space": -32008,
        "plan": -32009,
        "denied": -32010,
        "disk": -32011,
        "calibration": -32012,
    }
)
"""JSON-RPC code of each error kind."""

RigState = Literal["idle", "busy", "stopping"]
Interest = Literal["all", "own", "none"]


class _Params(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all parameters: nothing unknown."""


class NoParams(_Params, frozen=True):
    """The method takes nothing."""


class HelloParams(_Params, frozen=True):
    """What a client needs: the lowest protocol version (major, minor) that serves it."""

    protocol: tuple[int, int]


class PlanParams(CaptureRequest, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`capture.plan`: the request, and whether it may wait while the rig is taken."""

    queue: bool = False

    def request(self) -> CaptureRequest:
        """The request alone, as the engine takes it."""
        return CaptureRequest(**{f: getattr(self, f) for f in CaptureRequest.__struct_fields__})


class StartParams(PlanParams, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`capture.start`: the same, and whether it outlives its connection."""

    detach: bool = False


class StreamParams(StreamRequest, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`stream.start`: the request, and whether it may wait while the rig is taken."""

    queue: bool = False

    def request(self) -> StreamRequest:
        """The request alone, as the engine takes it."""
        return StreamRequest(**{f: getattr(self, f) for f in StreamRequest.__struct_fields__})


class CalibrateParams(CalibrateRequest, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`calibrate.start`: what to measure, and how to go about it as `capture.start` has it."""

    detach: bool = False
    queue: bool = False

    def request(self) -> CalibrateRequest:
        """The request alone, as the engine takes it."""
        return CalibrateRequest(**{f: getattr(self, f) for f in CalibrateRequest.__struct_fields__})


class JobParams(_Params, frozen=True):
    """Names one job."""

    job: Annotated[str, Meta(max_length=64)]


class FrameParams(JobParams, frozen=True):
    """`preview.frame`: the newest picture after that number, awaited, with its JPEG or without."""

    after: Annotated[int, Meta(ge=0, lt=2**53)] = 0
    picture: bool = True


class StreamFrameParams(JobParams, frozen=True):
    """`stream.frame`: the newest picture after that number, awaited: its figures alone, as a JPEG,
    too, or as arrays, in memory whose descriptor comes with the answer."""

    after: Annotated[int, Meta(ge=0, lt=2**53)] = 0
    picture: Literal["none", "jpeg", "arrays"] = "none"


class ListParams(_Params, frozen=True):
    """`capture.list`: which runs of the state folder to find, too."""

    find: RunQuery | None = None


class LiveParams(_Params, frozen=True):
    """`preview.live`: what the panels hold meanwhile; `index` picks the code of the pattern
    "code"."""

    pattern: PatternName = "white"
    index: Annotated[int, Meta(ge=0, lt=2**31)] = 0


class ShowParams(_Params, frozen=True):
    """`display.show`: a test picture; `index` picks the code of the pattern "code", and `detach`
    leaves it on when the connection ends."""

    pattern: PatternName
    index: Annotated[int, Meta(ge=0, lt=2**31)] = 0
    detach: bool = False


class SubscribeParams(_Params, frozen=True):
    """`events.subscribe`: events of all jobs, or of those started on this connection."""

    jobs: Literal["all", "own"] = "own"


class ClockAnchor(msgspec.Struct, frozen=True):
    """One instant on two clocks: ns since boot (as all event times are) and ISO 8601 UTC."""

    mono_ns: int
    utc: str


class Hello(msgspec.Struct, frozen=True, kw_only=True):
    """What the server says first, as a notification `hello`."""

    server: str
    version: str
    protocol: tuple[int, int]
    max_line: int
    drivers: dict[str, str]
    state: RigState
    clock: ClockAnchor


class Admission(msgspec.Struct, frozen=True, kw_only=True):
    """Answer of `capture.start`, `calibrate.start`, `calibrate.proceed`, `preview.live` and
    `stream.start`."""

    job: str
    state: JobState


class JobView(msgspec.Struct, frozen=True, kw_only=True):
    """One job as `capture.list` and `rig.status` show it.

    `goal` is that of a capture or a plan, the pattern of a show or a live view, "white" for a
    preview, the steps of a calibration.
    """

    job: str
    state: JobState
    goal: str
    kind: JobKind = "capture"
    owner: OwnerView
    detach: bool
    created_utc: str
    folder: str | None = None


class JobList(msgspec.Struct, frozen=True):
    """Answer of `capture.list`: jobs oldest first, finished ones of each kind up to a bound."""

    jobs: list[JobView]
    found: Page | None = None
    """The runs of the state folder that `find` asked for, including those of the jobs."""


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """Answer of `rig.status`."""

    version: str
    state: RigState
    running: JobView | None
    queued: list[JobView]
    connections: int
    uptime_s: float
    clock: ClockAnchor


class GoalView(msgspec.Struct, frozen=True, kw_only=True):
    """What a goal keeps of the light, in words, and which parameters it needs and may be given."""

    keeps: str
    needs: tuple[str, ...]
    may: tuple[str, ...]


class RigDescription(msgspec.Struct, frozen=True):
    """Answer of `rig.describe`: the rig, the JSON Schema of every message (`build_message_schema`),
    the goals by name, and in words what the arrays among their parameters hold."""

    rig: RigView
    schema: dict[str, Any]
    goals: dict[str, GoalView] = {}
    arrays: dict[str, str] = {}


class Subscription(msgspec.Struct, frozen=True):
    """Answer of `events.subscribe` and `events.unsubscribe`: what is now delivered."""

    jobs: Interest


class ShowReply(msgspec.Struct, frozen=True):
    """Answer of `display.show`: what both panels show now, and the job that keeps them at it."""

    pattern: str
    index: int
    job: str


class Pong(msgspec.Struct, frozen=True):
    """Answer of `ping`."""

    clock: ClockAnchor


class HelloReply(msgspec.Struct, frozen=True):
    """Answer of `hello`: the server's protocol version."""

    protocol: tuple[int, int]


class ErrorData(msgspec.Struct, frozen=True, kw_only=True):
    """The part of an error that clients match on."""

    kind: str
    device: str | None = None
    hint: str | None = None


class ErrorObject(msgspec.Struct, frozen=True):
    """`error` of a reply (JSON-RPC 2.0, section 5.1)."""

    code: int
    message: str
    data: ErrorData


@dataclass(frozen=True)
class Method:
    """What a method takes and returns, and who may call it; `result` is used for the schema only.

    `takes_fds` says that descriptors may come with it.
    """

    params: type[msgspec.Struct]
    result: type[msgspec.Struct]
    role: ClientRole = ClientRole.LOOK
    takes_fds: bool = False


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "hello": Method(HelloParams, HelloReply),
        "ping": Method(NoParams, Pong),
        "rig.status": Method(NoParams, Status),
        "rig.describe": Method(NoParams, RigDescription),
        # It has paths, ports, and who may do what: nothing that a client who only looks needs.
        "config.get": Method(NoParams, Config, ClientRole.SHOOT),
        "capture.plan": Method(PlanParams, PlanSummary, ClientRole.SHOOT, takes_fds=True),
        "capture.start": Method(StartParams, Admission, ClientRole.SHOOT, takes_fds=True),
        "capture.wait": Method(JobParams, CaptureResult),
        # For another user's job, administrators only (`pdcd.server.methods`).
        "capture.cancel": Method(JobParams, CaptureResult, ClientRole.SHOOT),
        "capture.list": Method(ListParams, JobList),
        "calibrate.start": Method(CalibrateParams, Admission, ClientRole.SHOOT),
        # For another user's job, administrators only, as with capture.cancel.
        "calibrate.proceed": Method(JobParams, Admission, ClientRole.SHOOT),
        "display.show": Method(ShowParams, ShowReply, ClientRole.SHOOT),
        "preview.grab": Method(NoParams, PreviewView, ClientRole.SHOOT),
        "preview.live": Method(LiveParams, Admission, ClientRole.SHOOT),
        # For another user's job, administrators only, as with capture.cancel.
        "preview.frame": Method(FrameParams, LiveFrame, ClientRole.SHOOT),
        "stream.start": Method(StreamParams, Admission, ClientRole.SHOOT, takes_fds=True),
        # For another user's job, administrators only, as with capture.cancel.
        "stream.frame": Method(StreamFrameParams, StreamFrame, ClientRole.SHOOT),
        "stream.record": Method(JobParams, CaptureResult, ClientRole.SHOOT),
        "events.subscribe": Method(SubscribeParams, Subscription),
        "events.unsubscribe": Method(NoParams, Subscription),
    }
)
"""Every method of the socket, by name."""


def to_wire_types(value: object) -> Any:
    """The value in JSON types; numpy's numbers become Python's. Raises TypeError otherwise."""
    return msgspec.to_builtins(value, enc_hook=_number)


def _number(value: object) -> int | float:
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value)
    raise TypeError(f"{type(value).__name__} cannot be sent as JSON")


def make_error_object(error: PdcdError, code: int | None = None) -> ErrorObject:
    """The error as an answer carries it; `code` replaces the code of its kind."""
    data = ErrorData(kind=error.kind, device=error.device, hint=error.hint)
    return ErrorObject(CODES[error.kind] if code is None else code, error.message, data)


@functools.cache
def build_message_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of every message, for `rig.describe`.

    Returns ``{"methods": {name: {"params", "result"}}, "notifications": {...}, "error", "kinds",
    "$defs"}``, where each leaf is a schema that refers into `$defs`.
    """
    leaves: list[object] = [t for m in METHODS.values() for t in (m.params, m.result)]
    notifications: dict[str, object] = {"hello": Hello, "event": events.KnownEvent}
    leaves += [*notifications.values(), ErrorObject]
    schemas, definitions = msgspec.json.schema_components(leaves, ref_template="#/$defs/{name}")
    for kind in events.TYPES.values():
        # The engine leaves out the common fields; events that are sent have all of them.
        sent = definitions[kind.__name__]
        sent["required"] = list(sent["properties"])
        for name in events.COMMON_FIELDS:
            sent["properties"][name].pop("default", None)
    made = iter(schemas)
    return {
        "methods": {name: {"params": next(made), "result": next(made)} for name in METHODS},
        "notifications": {name: next(made) for name in notifications},
        "error": next(made),
        "kinds": list(KINDS),
        "$defs": definitions,
    }


def check_version(hello: Mapping[str, Any]) -> None:
    """Raise ProtocolError when this client does not fit that server."""
    major, minor = hello["protocol"]
    if major != PROTOCOL[0] or minor < PROTOCOL[1]:
        raise ProtocolError(
            f"the server speaks protocol {major}.{minor}, not {PROTOCOL[0]}.{PROTOCOL[1]}",
            hint="use the client that came with this server",
        )


def convert_reply(value: Any, kind: type[_T]) -> _T:
    """The value in that type. Raises ProtocolError when it does not fit."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as err:
        raise ProtocolError(f"the server sent something that is no {kind.__name__}: {err}") from err


def read_event(message: Mapping[str, Any]) -> events.Event:
    """The event in a notification of the server. Raises ProtocolError when it is not one."""
    try:
        return events.decode_event(message["params"])
    except msgspec.ValidationError as err:
        raise ProtocolError(f"the server sent something that is no event: {err}") from err


def decode_error(wire: Mapping[str, Any]) -> PdcdError:
    """The error of pdcd's own classes for an error in a message; an unknown kind becomes the base
    class."""
    data = wire.get("data") or {}
    return make_error(
        str(data.get("kind")), str(wire.get("message")), data.get("device"), data.get("hint")
    )
