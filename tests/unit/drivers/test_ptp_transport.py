"""PTP transactions over a scripted port: every form a container may come in, and every wrong one.

The bytes are put together by hand from the layout in the still image class specification, not by
the code under test.
"""

from __future__ import annotations

import array
import errno
import struct
from contextlib import suppress
from typing import Any
from unittest.mock import Mock

import pytest
import usb.core
from hypothesis import given
from hypothesis import strategies as st

from drivers.ptp.codes import Operation, ResponseCode
from drivers.ptp.faults import (
    DeviceGone,
    EndpointStall,
    TransactionMismatch,
    WireFault,
    WireTimeout,
    to_wire_fault,
)
from drivers.ptp.transport import BLOCK_B, Transport
from pdcd.bench.clock import VirtualClock
from pdcd.errors import Cancelled, DeviceLost

PACKET_B = 512

COMMAND, DATA, RESPONSE, EVENT = 1, 2, 3, 4

READ = Operation.GET_PARTIAL_OBJECT


def container(kind: int, code: int, number: int, payload: bytes = b"") -> bytes:
    return struct.pack("<IHHI", 12 + len(payload), kind, code, number) + payload


def ok(number: int, *params: int) -> bytes:
    return container(RESPONSE, 0x2001, number, struct.pack(f"<{len(params)}I", *params))


def data(payload: bytes, number: int = 0) -> bytes:
    return container(DATA, READ, number, payload)


class Port:
    """Hands out the transfers of a script, cut to the reader's buffer, and notes what is sent."""

    packet_b = PACKET_B
    name = "scripted"

    def __init__(self, *transfers: bytes | WireFault, status: tuple[int, ...] = (0x2001,)) -> None:
        self.transfers = list(transfers)
        self.statuses = list(status)
        self.written: list[bytes] = []
        self.cancelled: list[int] = []
        self.done: list[str] = []

    def read_into(self, buffer: array.array[int], timeout_s: float) -> int:
        if not self.transfers:
            raise WireTimeout("does not answer")
        transfer = self.transfers.pop(0)
        if isinstance(transfer, WireFault):
            raise transfer
        now, rest = transfer[: len(buffer)], transfer[len(buffer) :]
        if rest:
            self.transfers.insert(0, rest)
        memoryview(buffer)[: len(now)] = now
        return len(now)

    def write(self, what: bytes, timeout_s: float) -> None:
        self.written.append(bytes(what))

    def cancel(self, number: int) -> None:
        self.cancelled.append(number)

    def status(self) -> int:
        return self.statuses.pop(0) if len(self.statuses) > 1 else self.statuses[0]

    def device_reset(self) -> None:
        self.done.append("device reset")

    def usb_reset(self) -> None:
        self.done.append("usb reset")

    def close(self) -> None:
        self.done.append("close")


def transport(port: Port) -> Transport:
    stand_in: Any = port
    return Transport(stand_in, VirtualClock())


def test_a_command_goes_out_as_the_specification_has_it() -> None:
    port = Port(ok(0), ok(1, 7))
    wire = transport(port)
    wire.transact(Operation.OPEN_SESSION, (1,))
    reply = wire.transact(Operation.EOS_SET_DEVICE_PROP_VALUE_EX, data=b"abc")
    assert port.written == [
        bytes.fromhex("10000000 0100 0210 00000000 01000000"),
        bytes.fromhex("0c000000 0100 1091 01000000"),
        bytes.fromhex("0f000000 0200 1091 01000000") + b"abc",
    ]
    assert (reply.code, reply.params) == (ResponseCode.OK, (7,))


@pytest.mark.parametrize("size", [0, 1, 499, 500, 501, 512, 1012, 5000, BLOCK_B, BLOCK_B + 5000])
@pytest.mark.parametrize("form", ["whole", "header alone", "glued", "packets", "empty packet"])
def test_data_comes_home_in_every_form(size: int, form: str) -> None:
    payload = bytes(i % 251 for i in range(size))
    whole = data(payload)
    transfers = {
        "whole": [whole, ok(0, size)],
        "header alone": [whole[:12], payload, ok(0, size)] if size else [whole, ok(0, size)],
        "glued": [whole + ok(0, size)],
        "packets": [whole[i : i + PACKET_B] for i in range(0, len(whole), PACKET_B)]
        + [ok(0, size)],
        "empty packet": [whole, b"", ok(0, size)],
    }[form]
    wire = transport(Port(*transfers))
    reply = wire.transact(READ)
    assert (reply.code, reply.params) == (ResponseCode.OK, (size,))
    assert bytes(reply.data) == payload


@pytest.mark.parametrize("size", [0, 100, 500, 3000])
def test_a_length_left_open_ends_with_a_short_packet(size: int) -> None:
    payload = bytes(i % 251 for i in range(size))
    whole = struct.pack("<IHHI", 0xFFFFFFFF, DATA, READ, 0) + payload
    packets = [whole[i : i + PACKET_B] for i in range(0, len(whole), PACKET_B)]
    if len(whole) % PACKET_B == 0 or size == 0:
        packets.append(b"")
    wire = transport(Port(*packets, ok(0)))
    assert bytes(wire.transact(READ).data) == payload


def test_a_response_instead_of_data_is_an_answer() -> None:
    wire = transport(Port(container(RESPONSE, 0x2009, 0)))
    reply = wire.transact(READ)
    assert reply.code == ResponseCode.INVALID_OBJECT_HANDLE and len(reply.data) == 0


def test_an_event_between_is_passed_over() -> None:
    wire = transport(Port(container(EVENT, 0xC101, 0xFFFFFFFF), data(b"x"), ok(0)))
    assert bytes(wire.transact(READ).data) == b"x"


@pytest.mark.parametrize(
    "transfers",
    {
        "another transaction's response": [ok(5)],
        "another transaction's data": [data(b"x", number=3), ok(0)],
        "another operation's data": [container(DATA, 0x9116, 0, b"x"), ok(0)],
        "data twice": [data(b"x"), data(b"y"), ok(0)],
        "a command": [container(COMMAND, READ, 0)],
        "an unknown type": [container(9, READ, 0)],
        "half a header": [b"\x0c\0\0\0\2"],
        "a length below the header's": [struct.pack("<IHHI", 4, RESPONSE, 0x2001, 0)],
        "a response cut off": [struct.pack("<IHHI", 24, RESPONSE, 0x2001, 0)],
        "a response of odd length": [container(RESPONSE, 0x2001, 0, b"abc")],
        "a response too long": [container(RESPONSE, 0x2001, 0, bytes(24))],
        "data that ends early": [data(bytes(3000))[:1100], ok(0)],
        "data of 3 GB": [struct.pack("<IHHI", 3 << 30, DATA, READ, 0) + bytes(500)],
        "empty packets without end": [b""] * 50,
        "events without end": [container(EVENT, 0xC101, 0)] * 50,
    }.values(),
)
def test_what_does_not_belong_is_out_of_step(transfers: list[bytes]) -> None:
    with pytest.raises(TransactionMismatch):
        transport(Port(*transfers)).transact(READ)


def test_silence_is_a_time_out() -> None:
    with pytest.raises(WireTimeout):
        transport(Port()).transact(READ)


def test_back_in_step_cancels_waits_and_drains() -> None:
    port = Port(
        ok(9), b"late data", data(b"good", number=1), ok(1), status=(0x2019, 0x2019, 0x2001)
    )
    wire = transport(port)
    with pytest.raises(TransactionMismatch):
        wire.transact(READ)
    rest = port.transfers[1:]
    del port.transfers[1:]
    wire.back_in_step()
    assert port.cancelled == [0] and port.transfers == []
    port.transfers = rest
    assert bytes(wire.transact(READ).data) == b"good"


@given(transfers=st.lists(st.binary(max_size=80), max_size=6), header=st.booleans())
def test_whatever_comes_is_a_reply_or_a_fault(transfers: list[bytes], header: bool) -> None:
    """Bytes without sense, alone or behind a header that is right as far as it goes."""
    first = [struct.pack("<IHHI", 60, DATA, READ, 0) + t for t in transfers[:1]] if header else []
    with suppress(WireFault):
        transport(Port(*first, *transfers)).transact(READ)


def test_transactions_are_numbered_from_0_up_to_the_one_that_means_all() -> None:
    port = Port(ok(0), ok(1), ok(0), ok(0xFFFFFFFE), ok(0))
    wire = transport(port)
    wire.transact(READ)
    wire.transact(READ)
    wire.restart_ids()
    wire.transact(READ)
    wire._next_id = 0xFFFFFFFE
    wire.transact(READ)
    wire.transact(READ)
    sent = [struct.unpack_from("<I", data, 8)[0] for data in port.written]
    assert sent == [0, 1, 0, 0xFFFFFFFE, 0]
    wire.usb_reset()
    wire.close()
    assert port.done == ["usb reset", "close"] and wire.name == "scripted"


def test_2_mib_of_data_are_taken_and_not_a_byte_more() -> None:
    """Event lists of 60 MiB, and objects of 4 GiB, are no answers to anything that is asked."""
    whole = 2 << 20
    for size, words in ((whole, "of 2097152 bytes"), (whole + 1, "announces 2097153 bytes")):
        head = struct.pack("<IHHI", 12 + size, DATA, READ, 0) + bytes(500)
        with pytest.raises(TransactionMismatch, match=words):
            transport(Port(head, ok(0))).transact(READ)


def test_what_came_too_much_is_of_the_next_container_and_forgotten_at_a_new_start() -> None:
    port = Port()
    wire = transport(port)
    for again in (wire.device_reset, wire.back_in_step):
        wire.restart_ids()
        port.transfers = [data(b"x") + ok(0) + b"rest"]
        assert bytes(wire.transact(READ).data) == b"x"
        again()
        wire.restart_ids()
        port.transfers = [ok(0)]
        assert wire.transact(READ).code == ResponseCode.OK


@pytest.mark.parametrize(("busy", "late", "fault"), [
    (19, 7, None), (20, 0, WireTimeout), (0, 8, TransactionMismatch), (0, -1, EndpointStall),
])  # fmt: skip
def test_back_in_step_waits_for_a_camera_and_empties_the_line(
    busy: int, late: int, fault: type[WireFault] | None
) -> None:
    """Two seconds until it is ready, and so much that was on its way; -1 is a line that fails."""
    transfers: list[Any] = [b"late"] * late if late >= 0 else [EndpointStall("halted")]
    port = Port(*transfers, status=(*[0x2019] * busy, 0x2001))
    wire = transport(port)
    if fault is None:
        wire.back_in_step()
    else:
        with pytest.raises(fault):
            wire.back_in_step()
    port = Port(b"late", b"", b"more")
    transport(port).back_in_step()  # an empty packet is an end, too
    assert port.transfers == [b"more"]


@pytest.mark.parametrize(
    ("error", "kind", "words"),
    [
        (usb.core.USBError("x", -4, errno.ENODEV), DeviceGone, "unplugged or switched off"),
        (usb.core.USBError("x", -4, errno.ESHUTDOWN), DeviceGone, "check cable"),
        (usb.core.USBError("x", -4, errno.ENXIO), DeviceGone, "unplugged"),
        (usb.core.USBError("x", -7, errno.ETIMEDOUT), WireTimeout, "does not answer"),
        (usb.core.USBTimeoutError("x", -7, None), WireTimeout, "does not answer"),
        (usb.core.USBError("x", -9, errno.EPIPE), EndpointStall, "endpoint halted"),
        (usb.core.USBError("x", -1, errno.EIO), TransactionMismatch, "USB transfer failed"),
        (usb.core.USBError("x", -1, None), TransactionMismatch, "USB transfer failed"),
    ],
)
def test_each_error_of_libusb_has_its_kind(
    error: usb.core.USBError, kind: type[WireFault], words: str
) -> None:
    fault = to_wire_fault(error)
    assert type(fault) is kind and words in str(fault)
    assert isinstance(fault, DeviceLost) and fault.device == "camera" and fault.hint


class Dribble(Port):
    """Sends a reply a packet at a time, each so many seconds after the last."""

    packet_b = 1

    def __init__(self, clock: VirtualClock, every_s: float, *transfers: bytes) -> None:
        super().__init__(*transfers)
        self.clock, self.every_s = clock, every_s

    def read_into(self, buffer: array.array[int], timeout_s: float) -> int:
        wait_s = min(self.every_s, timeout_s)
        self.clock.sleep_until_ns(self.clock.now_ns() + round(wait_s * 1e9))
        if wait_s < self.every_s:
            raise WireTimeout("does not answer")
        return super().read_into(buffer, timeout_s)


def test_a_reply_that_comes_a_byte_at_a_time_is_given_up_in_the_time_of_a_transaction() -> None:
    clock = VirtualClock()
    begun_ns = clock.now_ns()
    head = struct.pack("<IHHI", 12 + 10_000, DATA, READ, 0)
    port: Any = Dribble(clock, 0.1, head, *[b"x"] * 10_000)
    with pytest.raises(WireTimeout):
        Transport(port, clock).transact(READ)
    assert clock.now_ns() - begun_ns == pytest.approx(8e9, abs=1e6)


def test_what_was_broken_off_is_cancelled_before_the_next_transaction() -> None:
    port = Port(ok(0))
    wire = transport(port)
    wire.transact(READ)
    read, port.read_into = port.read_into, Mock(side_effect=Cancelled("enough"))  # type: ignore[method-assign]
    with pytest.raises(Cancelled):
        wire.transact(READ)
    assert port.cancelled == []
    port.read_into = read  # type: ignore[method-assign]
    port.transfers = [b"", ok(2)]
    assert wire.transact(READ).code == ResponseCode.OK
    assert port.cancelled == [1]
