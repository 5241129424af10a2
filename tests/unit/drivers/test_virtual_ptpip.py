"""The virtual camera's PTP/IP, spoken to with packets put together by hand."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator

import pytest

from drivers.virtual_camera import BULB_BODY, CameraBody, FaultScript, PlainFilm, ScriptedFault
from drivers.virtual_camera.ptpip import _LONGEST_BYTES, PtpIpServer
from pdcd.bench.clock import VirtualClock
from tests.processes import soon

HELLO = struct.pack("<II", 30, 1) + bytes(16) + b"x\0\0\0"[:2] + struct.pack("<I", 0x10000)

KEEP_ON = 0x911D
PHOTO = (bytes(range(251)) * 10_000)[:2_500_000]
GUID = b"pdcd" + bytes(10) + b"\x45\0"  # that of a 450D that is not there


class Line:
    """One connection; reads whole packets."""

    def __init__(self, server: PtpIpServer) -> None:
        self.socket = socket.create_connection((server.host, server.port), timeout=10.0)

    def send(self, kind: int, body: bytes) -> None:
        self.socket.sendall(struct.pack("<II", 8 + len(body), kind) + body)

    def receive(self) -> tuple[int, bytes]:
        head = self._exactly(8)
        length, kind = struct.unpack("<II", head)
        return kind, self._exactly(length - 8)

    def _exactly(self, count: int) -> bytes:
        found = b""
        while len(found) < count:
            piece = self.socket.recv(count - len(found))
            if not piece:
                raise ConnectionResetError("the camera has gone")
            found += piece
        return found

    def operate(self, code: int, transaction: int, *parameters: int, out: int = 1) -> None:
        head = struct.pack("<IHI", out, code, transaction)
        self.send(6, head + struct.pack(f"<{len(parameters)}I", *parameters))

    def response(self) -> tuple[int, int]:
        """Code and transaction of a response that must come next."""
        kind, body = self.receive()
        assert kind == 7
        code, transaction = struct.unpack_from("<HI", body)
        return code, transaction

    def open(self) -> None:
        self.socket.sendall(HELLO)
        assert self.receive()[0] == 2
        self.operate(0x1002, 0, 1)
        assert self.response() == (0x2001, 0)


@pytest.fixture
def body() -> CameraBody:
    faults = (ScriptedFault("unplug", 0x911B), ScriptedFault("wrong-transaction", 0x911C))
    film = PlainFilm(lambda _: PHOTO)
    return CameraBody(VirtualClock(), film, BULB_BODY, FaultScript(wire=faults))


@pytest.fixture
def server(body: CameraBody) -> Iterator[PtpIpServer]:
    before = threading.active_count()
    with PtpIpServer(body, 0) as made:
        yield made
    assert threading.active_count() == before  # connections still open are ended, threads with them


@pytest.fixture
def line(server: PtpIpServer) -> Iterator[Line]:
    made = Line(server)
    yield made
    made.socket.close()


@pytest.mark.parametrize("end", ["closed", "reset", "nonsense", "within a packet"])
def test_a_connection_that_ends_in_any_way_ends_its_session(
    server: PtpIpServer, body: CameraBody, end: str
) -> None:
    """A client that was killed would else keep the next one out of step."""
    line = Line(server)
    line.open()
    assert body.session_open
    if end == "reset":
        line.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    elif end == "nonsense":
        line.send(99, b"")
    elif end == "within a packet":
        line.socket.sendall(b"\x20\0\0\0\x06")
    line.socket.close()
    assert soon(lambda: not body.session_open)


def test_data_go_both_ways(line: Line, body: CameraBody) -> None:
    line.open()
    iso = struct.pack("<III", 12, 0xD103, 0x50)
    line.operate(0x9110, 1, out=2)
    line.send(9, struct.pack("<IQ", 1, len(iso)))
    line.send(10, struct.pack("<I", 1) + iso[:5])
    line.send(12, struct.pack("<I", 1) + iso[5:])
    assert line.response() == (0x2001, 1)
    assert body.settings.iso == 200
    body.settings.put(0xD102, struct.pack("<I", 0x0C))
    body.press()
    body.release()
    (handle,) = body.store.files
    number, block = struct.pack("<I", 2), 1 << 20
    line.operate(0x1009, 2, handle)
    assert line.receive() == (9, struct.pack("<IQ", 2, len(PHOTO)))
    assert line.receive() == (10, number + PHOTO[:block])
    assert line.receive() == (10, number + PHOTO[block : 2 * block])
    assert line.receive() == (12, number + PHOTO[2 * block :])
    assert line.response() == (0x2001, 2)


@pytest.mark.parametrize("more", [0, 1, 999])
def test_data_of_a_client_have_an_end(line: Line, more: int) -> None:
    """In however many pieces: as many bytes as may be are looked at, if only to be refused."""
    line.open()
    line.operate(0x9110, 1, out=2)
    size = _LONGEST_BYTES + more
    data = struct.pack("<III", size, 0xD103, 0x50).ljust(size, b"\0")
    line.send(9, struct.pack("<IQ", 1, size))
    line.send(10, struct.pack("<I", 1) + data[: size // 2])
    line.send(12, struct.pack("<I", 1) + data[size // 2 :])
    if more:
        with pytest.raises(ConnectionError):
            line.response()
    else:
        assert line.response() == (0x201C, 1)  # no value of a setting is as long
        line.operate(KEEP_ON, 2)
        assert line.response() == (0x2001, 2)


@pytest.mark.parametrize(
    "nonsense",
    [
        b"\xff" * 64,  # a length no packet has
        struct.pack("<II", 4, 1),  # shorter than its head
        struct.pack("<II", 8, 99),  # an unknown type
        struct.pack("<IIIHI", 18, 6, 1, KEEP_ON, 0),  # an operation before the greeting
        HELLO + struct.pack("<IIH", 10, 6, 1),  # an operation cut short
        HELLO + struct.pack("<IIIHI", 18, 6, 2, 0x9110, 0) + struct.pack("<II", 8, 13),
    ],
)
def test_nonsense_ends_the_connection_and_nothing_else(
    server: PtpIpServer, line: Line, nonsense: bytes
) -> None:
    line.socket.sendall(nonsense)
    with pytest.raises(ConnectionError):
        for _ in range(3):
            line.receive()
    again = Line(server)
    again.socket.sendall(HELLO)
    assert again.receive()[0] == 2
    again.socket.close()


def test_faults_that_tcp_can_carry(server: PtpIpServer, line: Line, body: CameraBody) -> None:
    line.open()
    line.operate(0x911C, 1)
    assert line.response() == (0x2001, 2)
    line.operate(0x911B, 2)
    with pytest.raises(ConnectionError):
        line.receive()
    refused = Line(server)
    refused.socket.sendall(HELLO)
    assert refused.receive()[0] == 5
    body.replug()
    refused.socket.sendall(HELLO)
    assert refused.receive()[0] == 2
    refused.socket.close()


def test_a_client_is_greeted_with_number_name_and_version(line: Line, body: CameraBody) -> None:
    line.socket.sendall(HELLO)
    name = "Virtual EOS".encode("utf-16-le") + b"\0\0"
    assert line.receive() == (2, struct.pack("<I", 1) + GUID + name + struct.pack("<I", 0x10000))
    line.send(13, b"")
    assert line.receive() == (14, b"")
    for ignored in (11, 14):
        line.send(ignored, b"")
    line.operate(KEEP_ON, 4)
    assert line.response() == (0x2003, 4)  # no session yet
    line.operate(0x1002, 5, 1)
    assert line.response() == (0x2001, 5) and body.session_open
    line.operate(0x1002, 6, 9)
    assert line.receive() == (7, struct.pack("<HII", 0x201E, 6, 1))


def test_events_have_a_line_of_their_own(line: Line) -> None:
    line.send(3, struct.pack("<I", 1))
    assert line.receive() == (4, b"")
    line.operate(0x1002, 0, 1)  # which is none for operations
    with pytest.raises(ConnectionError):
        line.receive()


def test_the_end_of_the_server_is_the_end_of_its_lines(body: CameraBody) -> None:
    with PtpIpServer(body, 0) as server:
        assert (server.host, server.port > 0) == ("127.0.0.1", True)
        lines = Line(server), Line(server)
        for line in lines:
            line.socket.sendall(HELLO)
            assert line.receive()[0] == 2
    for line in lines:
        with pytest.raises(ConnectionError):
            line.receive()
        line.socket.close()
