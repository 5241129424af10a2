"""The client's end of the socket: lines out with descriptors, lines in with descriptors."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from pdcd.errors import BusyError, PdcdError, ProtocolError, RequestError
from pdcd.protocol.events import Event
from pdcd.protocol.messages import MAX_FDS, MAX_LINE, decode_error, read_event

EventHandler = Callable[[Event], None]
"""Takes one event, a struct of `pdcd.protocol.events`; `type` names its kind."""

_CONNECT_INTERVAL_S = 0.02
"""Pause in seconds before a full backlog is tried again."""

_CONTROL_BYTES = socket.CMSG_LEN(MAX_FDS * struct.calcsize("i"))


class UnreachableError(ConnectionError):
    """No daemon answers, it went away, or it took too long; the message says where."""


class LineTalk:
    """One connection, for one thread; `pdcd.client.Client` has the methods that can be called on
    it."""

    def __init__(self, socket_path: Path | str, timeout_s: float) -> None:
        self._path = str(socket_path)
        self._timeout_s = timeout_s
        self._next_id = 0
        self._rest = bytearray()
        self._lines: deque[bytes] = deque()
        self._fds: deque[int] = deque()
        """Descriptors that came with answers, in their order."""
        self._events: deque[Event] = deque()
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._sock.settimeout(timeout_s)

    def close(self) -> None:
        """Close the connection. Idempotent; ends a wait of another thread, too."""
        with contextlib.suppress(OSError):  # not connected, or no longer
            self._sock.shutdown(socket.SHUT_RDWR)
        self._sock.close()
        while self._fds:
            os.close(self._fds.popleft())

    def _connect(self) -> None:
        """Connect. A full backlog means that the daemon is busy, not that it is missing."""
        until_s = time.monotonic() + self._timeout_s
        while not self._connected():
            if time.monotonic() > until_s:
                raise BusyError(
                    f"too many clients wait before the daemon on {self._path}:"
                    f" there was no room for {self._timeout_s:g} s",
                    hint="it may still be starting the rig: see its log, or try again later",
                )
            time.sleep(_CONNECT_INTERVAL_S)

    def _connected(self) -> bool:
        try:
            self._sock.connect(self._path)
        except BlockingIOError:
            return False
        except OSError as err:
            raise UnreachableError(
                f"no daemon answers on {self._path}: {err.strerror or err}"
                " (start one with pdcd serve, or name its socket with --socket)"
            ) from err
        return True

    def _send(
        self, method: str, params: Mapping[str, object] | None, fds: Sequence[int] = ()
    ) -> int:
        """Send one request, with file descriptors that stay open here; returns the request's id."""
        self._next_id += 1
        message: dict[str, object] = {
            "jsonrpc": "2.0",
            "id": self._next_id,
            "method": method,
            "params": params or {},
        }
        if fds:
            message["fds"] = len(fds)
        try:
            line = msgspec.json.encode(message) + b"\n"
        except UnicodeEncodeError as err:
            what = f"{method}: {err.object!r:.80} is not UTF-8"
            raise RequestError(what, hint="does the terminal speak it?") from err
        if len(line) > MAX_LINE:
            raise ProtocolError(
                f"the request is {len(line)} bytes long", hint=f"at most {MAX_LINE} are allowed"
            )
        if len(fds) > MAX_FDS:
            raise ProtocolError(f"{len(fds)} descriptors", hint=f"at most {MAX_FDS} are allowed")
        try:
            self._sock.settimeout(self._timeout_s)
            # Descriptors go with the first bytes; the kernel need not take the whole line at once.
            sent = socket.send_fds(self._sock, [line], fds) if fds else 0
            self._sock.sendall(line[sent:])
        except OSError as err:
            gone = UnreachableError(f"the daemon on {self._path} went away: {err}")
            raise self._last_words() or gone from err
        return self._next_id

    def _last_words(self) -> PdcdError | None:
        """The reason why the daemon closed the connection, if it gave one."""
        try:
            while True:
                message = self._receive(0.0)
                if "error" in message and message.get("id") is None:
                    return decode_error(message["error"])
        except (UnreachableError, ProtocolError):
            return None

    def _answer(
        self, request_id: int, timeout_s: float | None, on_event: EventHandler | None
    ) -> Any:
        return self._hear_answer(request_id, timeout_s, on_event)["result"]

    def _hear_answer(
        self, request_id: int, timeout_s: float | None, on_event: EventHandler | None
    ) -> dict[str, Any]:
        while True:
            message = self._receive(timeout_s)
            if message.get("method") == "event":
                (self._events.append if on_event is None else on_event)(read_event(message))
            elif "error" in message and message.get("id") in (request_id, None):
                raise decode_error(message["error"])
            elif message.get("id") == request_id:
                return message

    def _receive(self, timeout_s: float | None) -> dict[str, Any]:
        """The next message. Raises UnreachableError at the end of the stream or after the
        timeout."""
        while not self._lines:
            try:
                self._sock.settimeout(timeout_s)
                # Not recv_fds, which drops its flags in some versions of Python.
                data, control, *_ = self._sock.recvmsg(
                    65536, _CONTROL_BYTES, socket.MSG_CMSG_CLOEXEC
                )
                for level, kind, sent in control:
                    if (level, kind) == (socket.SOL_SOCKET, socket.SCM_RIGHTS):
                        self._fds.extend(memoryview(sent[: len(sent) // 4 * 4]).cast("i"))
            except TimeoutError as err:
                raise UnreachableError(
                    f"the daemon on {self._path} has not answered for {timeout_s:g} s"
                    " (it may still be starting the rig: see its log)"
                ) from err
            except OSError as err:
                raise UnreachableError(f"the daemon on {self._path} went away: {err}") from err
            if not data:
                raise UnreachableError(f"the daemon on {self._path} closed the connection")
            *lines, last = (bytes(self._rest) + data).split(b"\n")
            self._rest[:] = last
            self._lines.extend(lines)
        try:
            message: dict[str, Any] = msgspec.json.decode(self._lines.popleft(), type=dict)
        except msgspec.DecodeError as err:
            raise ProtocolError(f"the server sent something that is no message: {err}") from err
        return message
