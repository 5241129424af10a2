"""The protocol without a socket: bytes in, typed requests and faults out; values in, lines out.

`Connection` is the state machine of one client. It never raises on what a client sends: anything
wrong becomes a `RpcFault`, which says what to answer and whether the connection can go on.

A request may name file descriptors that came with it. They are assigned to requests by counting, so
a client whose count is in doubt is disconnected.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated

import msgspec
from msgspec import UNSET, Meta, UnsetType

from pdcd.errors import PdcdError, ProtocolError, RequestError, make_error
from pdcd.files.text import encode_json
from pdcd.protocol import messages
from pdcd.protocol.fields import FieldError, decode_struct
from pdcd.protocol.messages import MAX_FDS, MAX_LINE, METHODS, PROTOCOL, HelloParams
from pdcd.server.descriptors import Descriptors

_Id = str | int
"""Request id. The limits below keep an echoed id exact in every client and the reply short."""

_WireId = (
    Annotated[str, Meta(max_length=128)] | Annotated[int, Meta(gt=-(2**53), lt=2**53)] | UnsetType
)


@dataclass(frozen=True)
class RpcRequest:
    """A checked call; `id` is None for a notification, which gets no answer.

    `fds` are the descriptors that came for it. They are closed when it has been answered or given
    up, whoever still reads them: a thread needs duplicates of its own (`os.dup`).
    """

    id: _Id | None
    method: str
    params: msgspec.Struct
    fds: tuple[int, ...] = ()
    """Descriptors that came with the line; whoever answers the request closes them."""


@dataclass(frozen=True)
class RpcFault:
    """A fault in what a client sent.

    `line` is the answer, None when there is none to give (a faulty notification); `close` is true
    where nothing sensible can follow on this connection.
    """

    error: PdcdError
    line: bytes | None
    close: bool = False


_MOST_TOLD = 8000
"""Longest text of an error, in characters."""

_Permit = Callable[[str], None]
"""Raises DeniedError for a method that the client may not call."""


class _Envelope(msgspec.Struct):
    """A request before its parameters are decoded; unknown members are ignored.

    The parameters are raw bytes: they are decoded only once it is known that the client may call
    the method, and only into the fields that the method has.
    """

    jsonrpc: str
    method: str
    id: _WireId = UNSET
    params: msgspec.Raw = msgspec.Raw(b"{}")
    fds: Annotated[int, Meta(ge=0, le=MAX_FDS)] = 0


class _IdOnly(msgspec.Struct):
    """For answering a malformed request with its id, where at least that is valid."""

    id: _WireId = UNSET


_BLANK = re.compile(rb"\s*\n")
_ENVELOPE = msgspec.json.Decoder(_Envelope)
_ID_ONLY = msgspec.json.Decoder(_IdOnly)
_ANYTHING = msgspec.json.Decoder(msgspec.Raw)


class Connection:
    """Cuts a byte stream into lines and lines into requests.

    `max_line` is the longest line accepted, in bytes, including its newline. `descriptors` receives
    those that come with the bytes, before the bytes; whoever made it closes it. `permit` decides
    what the client may call.
    """

    def __init__(
        self,
        max_line: int = MAX_LINE,
        descriptors: Descriptors | None = None,
        permit: _Permit = lambda method: None,
    ) -> None:
        self._max_line = max_line
        self._permit = permit
        self._descriptors = Descriptors() if descriptors is None else descriptors
        self._rest = bytearray()
        self.line_bytes = 0
        """Length of the line that was parsed last."""
        self.closed = False
        """True after a fault that ends the connection; all further bytes are ignored."""

    def receive(self, data: bytes, *, lost: bool = False) -> Iterator[RpcRequest | RpcFault]:
        """Take the next bytes, cut anywhere, and yield what they complete, in order: each line is
        parsed when it is asked for. All items must be consumed before more is received.

        `lost` means that more descriptors came with them than could be received.
        """
        if lost and not self.closed:
            yield self._part(_too_many())
        self._rest += data
        while not self.closed:
            # Blank lines are allowed: people type at this socket.
            del self._rest[: _count_blank(self._rest)]
            # A line is searched for only within its allowed length, so that a client cannot make
            # this process search or keep megabytes.
            end = self._rest.find(b"\n", 0, self._max_line)
            if end < 0:
                break
            line = bytes(self._rest[:end])
            del self._rest[: end + 1]
            self.line_bytes = len(line)
            yield self._close_on(parse_line(line, self._descriptors, self._permit))
        if not self.closed and len(self._rest) >= self._max_line:
            error = ProtocolError(
                f"a line is longer than {self._max_line} bytes",
                hint="send large data as files; every message is one short line",
            )
            yield self._part(error, messages.PARSE_ERROR)
        if not self.closed and self._descriptors.unclaimed > MAX_FDS:
            yield self._part(_too_many())
        if self.closed:
            self._rest.clear()
            self._descriptors.drop_unclaimed()

    def _part(self, error: PdcdError, code: int | None = None) -> RpcFault:
        self.closed = True
        return RpcFault(error, encode_error(None, error, code), True)

    def _close_on(self, item: RpcRequest | RpcFault) -> RpcRequest | RpcFault:
        self.closed = isinstance(item, RpcFault) and item.close
        return item


def _count_blank(data: bytearray) -> int:
    """Bytes of the blank lines at its beginning."""
    found = _BLANK.match(data)
    return 0 if found is None else found.end()


def _too_many() -> ProtocolError:
    return ProtocolError(
        f"more than {MAX_FDS} descriptors came that no request has named",
        hint='name them in their request, as "fds": how many',
    )


def parse_line(
    line: bytes, descriptors: Descriptors | None = None, permit: _Permit = lambda method: None
) -> RpcRequest | RpcFault:
    """Check one line, without its newline: a `RpcRequest`, or what is wrong with it.

    The request's descriptors are taken from `descriptors`; those of a faulty one are closed.
    `permit` is called before the parameters are decoded.
    """
    held = Descriptors() if descriptors is None else descriptors
    # A line that cannot be parsed does not say how many of the descriptors were meant for it.
    lost_count = held.unclaimed > 0
    try:
        line.decode()  # msgspec does not look into text that it leaves raw
        envelope = _ENVELOPE.decode(line)
        if envelope.jsonrpc != "2.0":
            raise msgspec.ValidationError('`jsonrpc` is not "2.0"')
    except (ValueError, RecursionError) as err:
        return _no_request(line, err, lost_count)
    return _with_fds(envelope, held, permit)


def _no_request(line: bytes, err: Exception, lost_count: bool) -> RpcFault:
    """The fault for a line that is no request, and perhaps no JSON."""
    wrong = err
    if isinstance(err, msgspec.ValidationError):
        try:
            _ANYTHING.decode(line)  # checks the syntax alone
        # ValueError covers bad syntax, NaN and Infinity, bad UTF-8.
        except (ValueError, RecursionError) as syntax:
            wrong = syntax
    if wrong is not err or not isinstance(err, msgspec.ValidationError):
        return _no_json(wrong, lost_count)
    if line.lstrip().startswith(b"["):
        error = ProtocolError("batches are not supported", hint="send one object a line")
        return RpcFault(error, encode_error(None, error), lost_count)
    error = ProtocolError(
        f"not a JSON-RPC 2.0 request: {err}",
        hint='a request is {"jsonrpc":"2.0","id":1,"method":"rig.status","params":{}}',
    )
    return RpcFault(error, encode_error(_sound_id(line), error), lost_count)


def _no_json(err: Exception, lost_count: bool) -> RpcFault:
    error = ProtocolError(
        f"not a JSON text: {err}", hint="send one JSON-RPC 2.0 object a line, in UTF-8"
    )
    return RpcFault(error, encode_error(None, error, messages.PARSE_ERROR), lost_count)


def _with_fds(
    envelope: _Envelope, descriptors: Descriptors, permit: _Permit
) -> RpcRequest | RpcFault:
    """Check method and parameters of a sound envelope, and give it its descriptors."""
    enough = envelope.fds <= descriptors.unclaimed
    try:
        fds = descriptors.take(envelope.fds)
    except PdcdError as err:
        return _fault(envelope, err, close=not enough)
    item = _typed(envelope, fds, permit)
    if isinstance(item, RpcFault):
        descriptors.release(fds)
    return item


def _sound_id(line: bytes) -> _Id | None:
    try:
        found = _ID_ONLY.decode(line).id
    except ValueError:
        return None
    return None if isinstance(found, UnsetType) else found


def _typed(envelope: _Envelope, fds: tuple[int, ...], permit: _Permit) -> RpcRequest | RpcFault:
    """Check method and parameters of a sound envelope."""
    close = False
    try:
        method = METHODS.get(envelope.method)
        if method is None:
            error = ProtocolError(
                f"unknown method {_short(envelope.method)}",
                hint="methods are: " + ", ".join(METHODS),
            )
            return _fault(envelope, error, messages.METHOD_NOT_FOUND)
        permit(envelope.method)
        if fds and not method.takes_fds:
            takers = ", ".join(name for name, method in METHODS.items() if method.takes_fds)
            raise ProtocolError(
                f"{envelope.method} takes no descriptors", hint=f"those that do: {takers}"
            )
        params = _params(envelope.method, envelope.params, method.params)
        if isinstance(params, HelloParams):
            close = True
            _agree(params.protocol)
    except PdcdError as err:
        # A new one: the original has a traceback and causes, which keep the line and its decoded
        # form alive.
        told = make_error(err.kind, err.message, err.device, err.hint)
        return _fault(envelope, told, close=close)
    except UnicodeDecodeError as err:
        return _no_json(err, False)
    return RpcRequest(_id_of(envelope), envelope.method, params, fds)


def _fault(
    envelope: _Envelope, error: PdcdError, code: int | None = None, *, close: bool = False
) -> RpcFault:
    """The fault for a valid envelope that cannot be served; a notification gets no answer."""
    request_id = _id_of(envelope)
    line = None if request_id is None else encode_error(request_id, error, code)
    return RpcFault(error, line, close)


def _id_of(envelope: _Envelope) -> _Id | None:
    return None if isinstance(envelope.id, UnsetType) else envelope.id


def _agree(wanted: tuple[int, int]) -> None:
    if wanted[0] != PROTOCOL[0] or wanted[1] > PROTOCOL[1]:
        raise ProtocolError(
            f"protocol {wanted[0]}.{wanted[1]} is not spoken here",
            hint=f"this server speaks {PROTOCOL[0]}.{PROTOCOL[1]}; use a matching client",
        )


def _params(method: str, raw: msgspec.Raw, kind: type[msgspec.Struct]) -> msgspec.Struct:
    try:
        return decode_struct(raw, kind)
    except FieldError as err:
        raise RequestError(
            f"{method}: {err}", hint="rig.describe has the schema of every message"
        ) from err
    except UnicodeDecodeError:
        raise
    # Besides msgspec's own errors, those that Python raises for extreme numbers and depths.
    except (ValueError, OverflowError, RecursionError) as err:
        names = ", ".join(kind.__struct_fields__) or "none"
        raise RequestError(
            f"{method}: {_short(str(err))}",
            hint=f"fields are: {names}; see rig.describe for their types",
        ) from err


def _short(text: str, limit: int = 200) -> str:
    """Quote a client's own text without echoing a megabyte of it."""
    return text if len(text) <= limit else text[:limit] + "..."


def encode_line(message: Mapping[str, object]) -> bytes:
    """One message as a line. Raises ProtocolError when it is longer than `MAX_LINE`."""
    line = encode_json(message) + b"\n"
    if len(line) > MAX_LINE:
        raise ProtocolError(
            f"the answer is {len(line)} bytes, longer than a line may be",
            hint="read it from the run folder instead",
        )
    return line


def encode_reply(request_id: _Id, result: object, *, fds: int = 0) -> bytes:
    """The answer to a request, sent with so many descriptors. Raises ProtocolError when it does not
    fit into a line."""
    told = {"jsonrpc": "2.0", "id": request_id, "result": result}
    return encode_line({**told, "fds": fds} if fds else told)


def encode_error(request_id: _Id | None, error: PdcdError, code: int | None = None) -> bytes:
    """The answer to a request that failed; id None where the id could not be read. It always fits
    into a line: longer texts are cut."""
    told = (error.message, error.device, error.hint)
    if sum(len(text) for text in told if text) > _MOST_TOLD:
        message, device, hint = (_short(text or "", _MOST_TOLD) or None for text in told)
        error = make_error(error.kind, message, device, hint)
    body = messages.make_error_object(error, code)
    return encode_line({"jsonrpc": "2.0", "id": request_id, "error": body})


def encode_notification(method: str, params: object) -> bytes:
    """A message that asks for no answer: `hello` or `event`."""
    return encode_line({"jsonrpc": "2.0", "method": method, "params": params})
