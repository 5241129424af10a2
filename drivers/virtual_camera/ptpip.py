"""The virtual camera on a network: PTP/IP (CIPA DC-005) on TCP, for libgphoto2 and the like.

Packets are a u32 length (of the whole), a u32 type, and a body, all little-endian. A client opens
one connection for operations and one for events, to the same port. One client at a time has the
camera; the body is not safe for two threads, so each operation holds a lock.

Scripted faults of the wire: a stall means nothing on TCP, so the answer simply goes out; "mute" and
"deaf" send nothing; "unplug" closes the connections; "short-read" ends the data early.
Not modelled: the pairing that Canon's network bodies ask for, discovery, events (EOS bodies are
asked for theirs).
"""

from __future__ import annotations

import logging
import socket
import socketserver
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum

from pdcd.driver import DecodeError

from ..ptp.datasets import Reader
from .body import DATA_OUT, CameraBody
from .reply import CameraReply

logger = logging.getLogger(__name__)

PORT = 15740
"""The registered port of PTP/IP."""

_HEAD = struct.Struct("<II")
_LONGEST_BYTES = 1 << 20  # of what a client sends: settings and names
_BLOCK_BYTES = 1 << 20
_VERSION = 0x00010000
_GUID = bytes.fromhex("70646364000000000000000000004500")
_REJECTED = 1


class Packet(IntEnum):
    """Types of PTP/IP packets."""

    INIT_COMMAND = 1
    INIT_COMMAND_ACK = 2
    INIT_EVENT = 3
    INIT_EVENT_ACK = 4
    INIT_FAIL = 5
    OPERATION = 6
    RESPONSE = 7
    EVENT = 8
    START_DATA = 9
    DATA = 10
    CANCEL = 11
    END_DATA = 12
    PING = 13
    PONG = 14


class PtpIpServer:
    """Serves one body on 127.0.0.1 (or `host`); `port` 0 takes a free one. Use it in a `with`."""

    def __init__(self, body: CameraBody, port: int = PORT, host: str = "127.0.0.1") -> None:
        self._tcp = _Tcp((host, port), _Connection)
        self._tcp.body = body
        self.host, self.port = host, int(self._tcp.server_address[1])
        self._thread = threading.Thread(target=self._tcp.serve_forever, args=(0.05,), daemon=True)

    def __enter__(self) -> PtpIpServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._tcp.shutdown()
        self._tcp.close_all()
        self._tcp.server_close()
        self._thread.join()

    def wait(self) -> None:
        """Serve until the process is interrupted."""
        self._thread.join()


class _Tcp(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = False  # closing waits for them: no thread outlives the server
    body: CameraBody

    def __init__(self, address: tuple[str, int], handler: type[_Connection]) -> None:
        super().__init__(address, handler)
        self.lock = threading.Lock()
        self._open: set[socket.socket] = set()

    @contextmanager
    def listed(self, connection: socket.socket) -> Iterator[None]:
        """Remember a connection while it is served, so that it can be ended from outside."""
        with self.lock:
            self._open.add(connection)
        try:
            yield
        finally:
            with self.lock:
                self._open.discard(connection)

    def close_all(self) -> None:
        """End every connection; their threads then end by themselves."""
        with self.lock:
            for connection in self._open:
                _end(connection)


def _end(connection: socket.socket) -> None:
    try:
        connection.shutdown(socket.SHUT_RDWR)
    except OSError as err:  # the other side closed it first
        logger.debug("connection was gone reason=%s", err)


class _Connection(socketserver.BaseRequestHandler):
    """One TCP connection, of either kind; its first packet says which."""

    server: _Tcp
    request: socket.socket
    _commands = False
    """Whether this is the connection for operations."""

    def handle(self) -> None:
        """Serve packets until the client goes, or sends something that is not a packet."""
        self.request.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            with self.server.listed(self.request):
                self._serve()
        except (ConnectionError, DecodeError) as err:
            logger.info("connection ends reason=%s", err)

    def _serve(self) -> None:
        try:
            self._packets()
        finally:
            if self._commands:  # a client that was killed leaves no session either
                with self.server.lock:
                    self.server.body.forget_session()

    def _packets(self) -> None:
        while (packet := self._receive()) is not None:
            kind, body = packet
            match kind:
                case Packet.INIT_COMMAND if self.server.body.plugged:
                    self._commands = True
                    name = "Virtual EOS".encode("utf-16-le") + b"\0\0"
                    self._send(
                        Packet.INIT_COMMAND_ACK,
                        struct.pack("<I", 1) + _GUID + name + struct.pack("<I", _VERSION),
                    )
                case Packet.INIT_COMMAND:
                    self._send(Packet.INIT_FAIL, struct.pack("<I", _REJECTED))
                case Packet.INIT_EVENT:
                    self._send(Packet.INIT_EVENT_ACK, b"")
                case Packet.OPERATION if self._commands:
                    self._operation(body)
                case Packet.PING:
                    self._send(Packet.PONG, b"")
                case Packet.CANCEL | Packet.PONG:
                    continue  # a cancel that comes after the answer, as there is no other
                case _:
                    raise DecodeError(f"PTP/IP packet of type {kind} out of place")

    def _operation(self, packet: bytes) -> None:
        take = Reader(packet, "PTP/IP operation")
        take.u32()
        code, transaction = take.u16(), take.u32()
        parameters = tuple(take.u32() for _ in range(min(5, take.left_bytes // 4)))
        data = self._data_out() if code in DATA_OUT else b""
        with self.server.lock:
            reply = self.server.body.transact(code, parameters, data)
        if reply.fault == "unplug":
            self.server.close_all()
        elif reply.fault not in ("mute", "deaf"):
            self._answer(transaction, reply)

    def _data_out(self) -> bytes:
        """The data of an operation: a start, any number of pieces, an end."""
        found = bytearray()
        while (packet := self._receive()) is not None:
            kind, body = packet
            if kind in (Packet.DATA, Packet.END_DATA):
                found += body[4:]
                if len(found) > _LONGEST_BYTES:
                    raise DecodeError("more data than any setting has")
            elif kind != Packet.START_DATA:
                raise DecodeError(f"PTP/IP packet of type {kind} where data were due")
            if kind == Packet.END_DATA:
                return bytes(found)
        raise DecodeError("the connection ended within an operation")

    def _answer(self, transaction: int, reply: CameraReply) -> None:
        if reply.data is not None:
            view = memoryview(reply.data)
            self._send(Packet.START_DATA, struct.pack("<IQ", transaction, len(view)))
            if reply.fault == "short-read":
                view = view[: len(view) // 2]
            number = struct.pack("<I", transaction)
            while len(view) > _BLOCK_BYTES:
                self._send(Packet.DATA, number, view[:_BLOCK_BYTES])
                view = view[_BLOCK_BYTES:]
            self._send(Packet.END_DATA, number, view)
        stated = transaction + 1 if reply.fault == "wrong-transaction" else transaction
        head = struct.pack("<HI", reply.code, stated & 0xFFFFFFFF)
        self._send(
            Packet.RESPONSE, head + struct.pack(f"<{len(reply.parameters)}I", *reply.parameters)
        )

    def _send(self, kind: int, body: bytes, payload: bytes | memoryview = b"") -> None:
        self.request.sendall(_HEAD.pack(_HEAD.size + len(body) + len(payload), kind) + body)
        if len(payload):
            self.request.sendall(payload)

    def _receive(self) -> tuple[int, bytes] | None:
        """Next packet's type and body; None when the client has gone between two packets."""
        head = self._exactly(_HEAD.size)
        if head is None:
            return None
        length, kind = _HEAD.unpack(head)
        if not _HEAD.size <= length <= _LONGEST_BYTES:
            raise DecodeError(f"a PTP/IP packet of {length} bytes")
        body = self._exactly(length - _HEAD.size)
        if body is None:
            raise DecodeError("the connection ended within a packet")
        return kind, body

    def _exactly(self, count: int) -> bytes | None:
        found = bytearray()
        while len(found) < count:
            piece = self.request.recv(count - len(found))
            if not piece:
                if found:
                    raise DecodeError("the connection ended within a packet")
                return None
            found += piece
        return bytes(found)
