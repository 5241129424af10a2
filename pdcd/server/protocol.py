"""The protocol without a socket: bytes in, typed requests and faults out; values in, lines out.

`Connection` is the state machine of one client. It never raises on what a client sends: all that
is wrong becomes a `RpcFault`, which says what to answer and whether the connection can go on.

A request may name file descriptors that came with it. Which belong to which request is a matter of
counting, so a client whose count is in doubt is parted from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
from msgspec import UNSET, Meta, UnsetType

from pdcd.errors import PdcdError, ProtocolError, RequestError
from pdcd.protocol import messages
from pdcd.protocol.fields import FieldError, convert_struct
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
    """Something wrong that a client sent.

    `line` is the answer, None when there is none to give (a faulty notification); `close` tells
    that nothing sensible can follow on this connection.
    """

    error: PdcdError
    line: bytes | None
    close: bool = False


class _Envelope(msgspec.Struct):
    """A request before its parameters are looked at; unknown members are ignored."""

    jsonrpc: str
    method: str
    id: _WireId = UNSET
    params: Any = UNSET
    fds: Annotated[int, Meta(ge=0, le=MAX_FDS)] = 0


class _IdOnly(msgspec.Struct):
    """To answer a malformed request by its id where that at least is sound."""

    id: _WireId = UNSET


class Connection:
    """Cuts a byte stream into lines and lines into requests.

    `max_line` is the longest line accepted, in bytes, its newline included. `descriptors` gets
    what comes beside the bytes, before them; whoever made it closes it.
    """

    def __init__(self, max_line: int = MAX_LINE, descriptors: Descriptors | None = None) -> None:
        self._max_line = max_line
        self._descriptors = Descriptors() if descriptors is None else descriptors
        self._rest = bytearray()
        self.closed = False
        """True after a fault that ends the connection; all further bytes are ignored."""

    def receive(self, data: bytes, *, lost: bool = False) -> list[RpcRequest | RpcFault]:
        """Take the next bytes, of any cut, and return what they complete, in order.

        `lost` tells that more descriptors came with them than could be received.
        """
        found: list[RpcRequest | RpcFault] = []
        if lost and not self.closed:
            found.append(self._part(_too_many()))
        self._rest += data
        while not self.closed:
            # A line is looked for in no more than its allowed length, so that a client cannot
            # make us search or keep megabytes.
            end = self._rest.find(b"\n", 0, self._max_line)
            if end < 0:
                break
            line = bytes(self._rest[:end])
            del self._rest[: end + 1]
            # Blank lines are let pass: people type at this socket.
            if line.strip():
                found.append(self._close_on(parse_line(line, self._descriptors)))
        if not self.closed and len(self._rest) >= self._max_line:
            error = ProtocolError(
                f"a line is longer than {self._max_line} bytes",
                hint="send large data as files; every message is one short line",
            )
            found.append(self._part(error, messages.PARSE_ERROR))
        if not self.closed and self._descriptors.unclaimed > MAX_FDS:
            found.append(self._part(_too_many()))
        if self.closed:
            self._rest.clear()
            self._descriptors.drop_unclaimed()
        return found

    def _part(self, error: PdcdError, code: int | None = None) -> RpcFault:
        self.closed = True
        return RpcFault(error, encode_error(None, error, code), True)

    def _close_on(self, item: RpcRequest | RpcFault) -> RpcRequest | RpcFault:
        self.closed = isinstance(item, RpcFault) and item.close
        return item


def _too_many() -> ProtocolError:
    return ProtocolError(
        f"more than {MAX_FDS} descriptors came that no request has named",
        hint='name them in their request, as "fds": how many',
    )


def parse_line(line: bytes, descriptors: Descriptors | None = None) -> RpcRequest | RpcFault:
    """Check one line, without its newline: a `RpcRequest`, or what is wrong with it.

    The request's descriptors are taken from `descriptors`; those of a faulty one are closed.
    """
    held = Descriptors() if descriptors is None else descriptors
    # A line that cannot be read does not tell how many of the descriptors were meant for it.
    lost_count = held.unclaimed > 0
    try:
        value = msgspec.json.decode(line)
    except (ValueError, RecursionError) as err:
        # ValueError covers bad syntax, NaN and Infinity, bad UTF-8 and numbers out of range.
        error = ProtocolError(
            f"not a JSON text: {err}", hint="send one JSON-RPC 2.0 object a line, in UTF-8"
        )
        return RpcFault(error, encode_error(None, error, messages.PARSE_ERROR), lost_count)
    if isinstance(value, list):
        error = ProtocolError("batches are not supported", hint="send one object a line")
        return RpcFault(error, encode_error(None, error), lost_count)
    try:
        envelope = msgspec.convert(value, _Envelope)
        if envelope.jsonrpc != "2.0":
            raise ValueError('`jsonrpc` is not "2.0"')
    except ValueError as err:
        error = ProtocolError(
            f"not a JSON-RPC 2.0 request: {err}",
            hint='a request is {"jsonrpc":"2.0","id":1,"method":"rig.status","params":{}}',
        )
        return RpcFault(error, encode_error(_sound_id(value), error), lost_count)
    return _with_fds(envelope, held)


def _with_fds(envelope: _Envelope, descriptors: Descriptors) -> RpcRequest | RpcFault:
    """Check method and parameters of a sound envelope, and give it its descriptors."""
    enough = envelope.fds <= descriptors.unclaimed
    try:
        fds = descriptors.take(envelope.fds)
    except PdcdError as err:
        return _fault(envelope, err, close=not enough)
    item = _typed(envelope, fds)
    if isinstance(item, RpcFault):
        descriptors.release(fds)
    return item


def _sound_id(value: Any) -> _Id | None:
    try:
        found = msgspec.convert(value, _IdOnly).id
    except ValueError:
        return None
    return None if isinstance(found, UnsetType) else found


def _typed(envelope: _Envelope, fds: tuple[int, ...]) -> RpcRequest | RpcFault:
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
        if fds and not method.takes_fds:
            takers = ", ".join(name for name, method in METHODS.items() if method.takes_fds)
            raise ProtocolError(
                f"{envelope.method} takes no descriptors", hint=f"those that do: {takers}"
            )
        raw = {} if envelope.params is UNSET else envelope.params
        params = _params(envelope.method, raw, method.params)
        if isinstance(params, HelloParams):
            close = True
            _agree(params.protocol)
    except PdcdError as err:
        return _fault(envelope, err, close=close)
    return RpcRequest(_id_of(envelope), envelope.method, params, fds)


def _fault(
    envelope: _Envelope, error: PdcdError, code: int | None = None, *, close: bool = False
) -> RpcFault:
    """What a sound envelope that cannot be served is; a notification gets no answer."""
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


def _params(method: str, raw: Any, kind: type[msgspec.Struct]) -> msgspec.Struct:
    try:
        return convert_struct(raw, kind)
    except FieldError as err:
        raise RequestError(
            f"{method}: {err}", hint="rig.describe has the schema of every message"
        ) from err
    # Besides its own errors, what numbers and depths beyond all measure make Python raise.
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
    line = msgspec.json.encode(message) + b"\n"
    if len(line) > MAX_LINE:
        raise ProtocolError(
            f"the answer is {len(line)} bytes, longer than a line may be",
            hint="read it from the run folder instead",
        )
    return line


def encode_reply(request_id: _Id, result: object) -> bytes:
    """The answer to a request. Raises ProtocolError when it does not fit into a line."""
    return encode_line({"jsonrpc": "2.0", "id": request_id, "result": result})


def encode_error(request_id: _Id | None, error: PdcdError, code: int | None = None) -> bytes:
    """The answer to a request that failed; id None where the id could not be read."""
    body = messages.make_error_object(error, code)
    return encode_line({"jsonrpc": "2.0", "id": request_id, "error": body})


def encode_notification(method: str, params: object) -> bytes:
    """A message that asks for no answer: `hello` or `event`."""
    return encode_line({"jsonrpc": "2.0", "method": method, "params": params})
