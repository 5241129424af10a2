"""The virtual camera's packets on a network, byte by byte, by the numbers of CIPA DC-005."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

import pytest

from drivers.virtual_camera import CameraBody, FaultScript, PlainFilm, ScriptedFault
from drivers.virtual_camera.ptpip import PORT, Packet, PtpIpServer
from pdcd.bench.clock import VirtualClock

GUID = b"pdcd" + bytes(10) + b"\x45\0"  # that of a 450D that is not there
NAMES = (
    "INIT_COMMAND INIT_COMMAND_ACK INIT_EVENT INIT_EVENT_ACK INIT_FAIL OPERATION RESPONSE EVENT "
    "START_DATA DATA CANCEL END_DATA PING PONG"
)
SIZE = (2 << 20) + 5
PHOTO = bytes(range(256)) * (SIZE // 256) + bytes(SIZE % 256)


class Line:
    """One connection."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=30.0)

    def send(self, kind: int, body: bytes = b"") -> None:
        self.socket.sendall(struct.pack("<II", 8 + len(body), kind) + body)

    def exactly(self, count: int) -> bytes:
        found = b""
        while len(found) < count and (piece := self.socket.recv(count - len(found))):
            found += piece
        return found

    def receive(self) -> tuple[int, bytes] | None:
        head = self.exactly(8)
        if len(head) < 8:
            return None
        length, kind = struct.unpack("<II", head)
        return kind, self.exactly(length - 8)

    def operation(self, code: int, transaction: int, *parameters: int) -> None:
        packed = struct.pack(f"<IHI{len(parameters)}I", 1, code, transaction, *parameters)
        self.send(6, packed)

    def done(self, transaction: int, *parameters: int, code: int = 0x2001) -> bool:
        packed = struct.pack(f"<HI{len(parameters)}I", code, transaction, *parameters)
        return self.receive() == (7, packed)


def body_of(*faults: ScriptedFault) -> CameraBody:
    return CameraBody(VirtualClock(), PlainFilm(lambda _: PHOTO), script=FaultScript(wire=faults))


@pytest.fixture
def body() -> CameraBody:
    return body_of(
        ScriptedFault("wrong-transaction", 0x911D, first=2), ScriptedFault("stall", 0x911D)
    )


@pytest.fixture
def line(body: CameraBody) -> Iterator[Line]:
    with PtpIpServer(body, 0) as server:
        line = Line(server.port)
        yield line
        line.socket.close()


def greet(line: Line) -> tuple[int, bytes] | None:
    line.send(1, bytes(16) + "me".encode("utf-16-le") + b"\0\0" + struct.pack("<I", 0x10000))
    return line.receive()


def test_packets_have_the_numbers_of_the_standard() -> None:
    assert PORT == 15740
    assert {kind.name: kind.value for kind in Packet} == {
        name: number for number, name in enumerate(NAMES.split(), 1)
    }


def test_a_client_is_greeted_with_number_name_and_version(line: Line, body: CameraBody) -> None:
    name = "Virtual EOS".encode("utf-16-le") + b"\0\0"
    wanted = struct.pack("<I", 1) + GUID + name + struct.pack("<I", 0x10000)
    assert greet(line) == (2, wanted)
    line.send(13)
    assert line.receive() == (14, b"")
    for ignored in (11, 14):
        line.send(ignored)
    line.operation(0x1002, 5, 1)
    assert line.done(5) and body.session_open


def test_a_camera_without_its_cable_greets_nobody(line: Line, body: CameraBody) -> None:
    body.unplug()
    assert greet(line) == (5, struct.pack("<I", 1))


def test_events_have_a_line_of_their_own(line: Line) -> None:
    line.send(3, struct.pack("<I", 1))
    assert line.receive() == (4, b"")
    line.operation(0x1002, 0, 1)  # which is none for operations
    assert line.receive() is None


def test_data_come_in_blocks_of_a_mib_behind_their_length(line: Line, body: CameraBody) -> None:
    greet(line)
    for count, code in enumerate((0x1002, 0x9114, 0x9115)):
        line.operation(code, count, 1)
        assert line.done(count)
    body.settings._values[0xD102] = 0x0C
    body.press()
    body.release()
    body.clock.sleep_until_ns(body.clock.now_ns() + 10**9)
    body.shutter.records()
    (handle,) = body.store.files
    line.operation(0x1009, 7, handle)
    number = struct.pack("<I", 7)
    assert line.receive() == (9, number + struct.pack("<Q", SIZE))
    block = 1 << 20
    assert line.receive() == (10, number + PHOTO[:block])
    assert line.receive() == (10, number + PHOTO[block : 2 * block])
    assert line.receive() == (12, number + PHOTO[2 * block :])
    assert line.done(7)
    line.operation(0x101B, 8, handle, 0, block)  # a whole block is not cut
    assert line.receive() == (9, struct.pack("<IQ", 8, block))
    assert line.receive() == (12, struct.pack("<I", 8) + PHOTO[:block])
    assert line.done(8, block)


def test_data_to_the_camera_are_put_together(line: Line, body: CameraBody) -> None:
    greet(line)
    line.operation(0x1002, 0, 1)
    assert line.done(0)
    line.operation(0x9110, 1)
    number, setting = struct.pack("<I", 1), struct.pack("<3I", 12, 0xD103, 0x50)
    line.send(9, number + struct.pack("<Q", 12))
    line.send(10, number + setting[:5])
    line.send(12, number + setting[5:])
    assert line.done(1) and body.settings.iso == 200
    line.operation(0x9110, 2)
    line.send(6)  # where data are due
    assert line.receive() is None


def test_five_parameters_are_read_and_no_more(line: Line) -> None:
    greet(line)
    line.operation(0x1002, 0, 1, 2, 3, 4, 5, 6)
    assert line.done(0)
    line.operation(0x1002, 1, 9)
    assert line.done(1, 1, code=0x201E)


def test_an_answer_may_carry_anothers_number_and_a_stall_is_none(line: Line) -> None:
    greet(line)
    line.operation(0x1002, 0, 1)
    assert line.done(0)
    line.operation(0x911D, 1)
    assert line.done(1)
    line.operation(0x911D, 0xFFFFFFFF)
    assert line.done(0)  # the one after the last is the first


@pytest.mark.parametrize(("length", "taken"), [(8, True), (7, False), ((1 << 20) + 1, False)])
def test_a_packet_is_a_head_at_least_and_a_mib_at_most(
    line: Line, length: int, taken: bool
) -> None:
    line.socket.sendall(struct.pack("<II", length, 13))
    assert (line.receive() == (14, b"")) == taken


def test_a_packet_of_a_mib_is_taken(line: Line) -> None:
    line.send(13, bytes((1 << 20) - 8))
    assert line.receive() == (14, b"")


def test_a_packet_that_is_cut_off_ends_the_line(line: Line, body: CameraBody) -> None:
    greet(line)
    line.operation(0x1002, 0, 1)
    assert line.done(0)
    line.socket.sendall(struct.pack("<II", 9, 13))
    line.socket.shutdown(socket.SHUT_WR)
    assert line.receive() is None


def test_the_end_of_the_server_is_the_end_of_its_lines(body: CameraBody) -> None:
    with PtpIpServer(body, 0) as server:
        assert (server.host, server.port > 0) == ("127.0.0.1", True)
        lines = Line(server.port), Line(server.port)
        for line in lines:
            assert greet(line) is not None
    assert [line.receive() for line in lines] == [None, None]
    for line in lines:
        line.socket.close()
