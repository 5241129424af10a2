"""The wire's bounds: how long is waited for what, how often, and how much is taken at most."""

from __future__ import annotations

import array
import errno
import struct
import threading
from pathlib import Path
from typing import Any

import pytest
import usb.core

from drivers.ptp import events, faults, holders
from drivers.ptp.codes import ContainerType, Property
from drivers.ptp.containers import (
    HEADER_BYTES,
    MAX_PARAMETERS,
    WireError,
    pack_data_header,
    pack_message,
    parse_header,
    parse_message,
)
from drivers.ptp.datasets import DeviceInfo, ObjectInfo, pack_string, parse_custom_functions
from drivers.ptp.events import AvailList, ObjectAdded, parse_events
from drivers.ptp.faults import (
    DeviceGone,
    EndpointStall,
    SessionLost,
    TransactionMismatch,
    WireFault,
    WireTimeout,
)
from drivers.ptp.keepalive import PERIOD_S, KeepAlive
from drivers.ptp.transport import BLOCK_B, TRANSACTION_S, Transport
from pdcd.bench.clock import VirtualClock
from pdcd.errors import ConfigError, DeviceLost

MS = 1_000_000
READ = 0x101B
OK = struct.pack("<IHHI", 12, 3, 0x2001, 0)


def response(number: int) -> bytes:
    return struct.pack("<IHHI", 12, 3, 0x2001, number)


class Port:
    """Hands out transfers and statuses, the last for ever, and notes what is asked of it."""

    packet_b = 512
    name = "scripted"

    def __init__(self, *transfers: bytes, statuses: tuple[int, ...] = (0x2001,)) -> None:
        self.transfers, self.statuses = list(transfers), list(statuses)
        self.done: list[Any] = []

    def read_into(self, buffer: array.array[int], timeout_s: float) -> int:
        self.done.append(("read", len(buffer), timeout_s))
        if not self.transfers:
            raise WireTimeout("does not answer")
        transfer = self.transfers.pop(0)
        memoryview(buffer)[: len(transfer)] = transfer
        return len(transfer)

    def write(self, data: bytes, timeout_s: float) -> None:
        self.done.append(("write", bytes(data), timeout_s))

    def cancel(self, number: int) -> None:
        self.done.append(("cancel", number))

    def status(self) -> int:
        self.done.append("status")
        return self.statuses.pop(0) if len(self.statuses) > 1 else self.statuses[0]

    def device_reset(self) -> None:
        self.done.append("device reset")

    def usb_reset(self) -> None:
        self.done.append("usb reset")

    def close(self) -> None:
        self.done.append("close")

    def count(self, what: str) -> int:
        return sum(1 for one in self.done if one == what or one[0] == what)


def wire_of(port: Port) -> tuple[Transport, VirtualClock]:
    clock = VirtualClock()
    stand_in: Any = port
    return Transport(stand_in, clock), clock


# Transactions.


def test_transactions_are_numbered_from_0_and_from_0_again_when_told() -> None:
    port = Port(response(0), response(1), response(0))
    wire, _ = wire_of(port)
    wire.transact(READ)
    wire.transact(READ)
    wire.restart_ids()
    wire.transact(READ)
    sent = [one[1] for one in port.done if one[0] == "write"]
    assert [struct.unpack_from("<I", data, 8)[0] for data in sent] == [0, 1, 0]


def test_numbers_end_below_the_one_that_means_all() -> None:
    port = Port(response(0xFFFFFFFE), response(0))
    wire, _ = wire_of(port)
    wire._next_id = 0xFFFFFFFE
    wire.transact(READ)
    wire.transact(READ)
    wire.back_in_step()
    assert ("cancel", 0) in port.done


def test_each_transfer_has_its_bound() -> None:
    port = Port(OK, response(1))
    wire, _ = wire_of(port)
    wire.transact(READ, (1, 2))
    wire.transact(READ, data=b"abc", timeout_s=1.25)
    assert TRANSACTION_S == 8.0 and BLOCK_B == 1 << 20
    bounds = [(one[0], one[2]) for one in port.done]
    assert bounds == [
        ("write", 8.0), ("read", 8.0), ("write", 1.25), ("write", 1.25), ("read", 1.25),
    ]  # fmt: skip
    assert port.done[1][1] >= BLOCK_B + HEADER_BYTES  # a block and its header in one transfer


@pytest.mark.parametrize(("events_before", "heard"), [(7, True), (8, False)])
def test_of_what_does_not_belong_seven_are_passed_over(events_before: int, heard: bool) -> None:
    for stray in (struct.pack("<IHHI", 12, 4, 0xC101, 0), b""):
        wire, _ = wire_of(Port(*[stray] * events_before, OK))
        if heard:
            assert wire.transact(READ).code == 0x2001
        else:
            with pytest.raises(TransactionMismatch, match="without end"):
                wire.transact(READ)


def test_64_mib_of_data_are_taken_and_not_a_byte_more() -> None:
    whole = 64 << 20
    for size, words in ((whole, "sent 500 of 67108864"), (whole + 1, "announces 67108865 bytes")):
        head = struct.pack("<IHHI", 12 + size, 2, READ, 0) + bytes(500)
        wire, _ = wire_of(Port(head[:-1] if size == whole else head, OK))
        expected = "sent 499 of 67108864" if size == whole else words
        with pytest.raises(TransactionMismatch, match=expected):
            wire.transact(READ)


def test_what_came_too_much_is_of_the_next_container_and_forgotten_at_a_new_start() -> None:
    both = struct.pack("<IHHI", 13, 2, READ, 0) + b"x" + OK
    port = Port(both, OK + b"rest")
    wire, _ = wire_of(port)
    assert bytes(wire.transact(READ).data) == b"x"
    for again in (wire.device_reset, wire.back_in_step):
        wire.restart_ids()
        port.transfers = [OK + b"rest"]
        wire.transact(READ)
        again()
        wire.restart_ids()
        port.transfers = [OK]
        assert wire.transact(READ).code == 0x2001


def test_back_in_step_waits_two_seconds_for_a_camera_to_get_ready() -> None:
    for busy, ready in ((19, True), (20, False)):
        port = Port(statuses=(*[0x2019] * busy, 0x2001))
        wire, clock = wire_of(port)
        before_ns = clock.now_ns()
        if ready:
            wire.back_in_step()
            assert port.done[-1][2] == 0.1  # what is left on the line comes at once
        else:
            with pytest.raises(WireTimeout, match="does not get ready"):
                wire.back_in_step()
        assert port.count("status") == 20
        assert clock.now_ns() - before_ns == busy * 100 * MS


@pytest.mark.parametrize(("late", "quiet"), [(0, True), (7, True), (8, False)])
def test_a_line_is_emptied_of_so_much(late: int, quiet: bool) -> None:
    port = Port(*[b"late"] * late)
    wire, _ = wire_of(port)
    if quiet:
        wire.back_in_step()
        assert port.count("read") == late + 1
    else:
        with pytest.raises(TransactionMismatch, match="goes on sending"):
            wire.back_in_step()
    port = Port(b"late", b"", b"more")
    wire_of(port)[0].back_in_step()  # an empty packet is an end, too
    assert port.transfers == [b"more"]


def test_a_line_that_fails_while_it_is_emptied_is_not_in_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    port = Port()
    wire, _ = wire_of(port)

    def fail(*_: Any) -> int:
        raise EndpointStall("halted")

    monkeypatch.setattr(port, "read_into", fail)
    with pytest.raises(EndpointStall):
        wire.back_in_step()


def test_the_rest_is_the_ports_own_affair() -> None:
    port = Port()
    wire, _ = wire_of(port)
    wire.usb_reset()
    wire.close()
    assert port.done == ["usb reset", "close"] and wire.name == "scripted"


# Faults.


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
    fault = faults.to_wire_fault(error)
    assert type(fault) is kind and words in str(fault)
    assert isinstance(fault, DeviceLost) and fault.device == "camera" and fault.hint


def test_faults_say_what_to_do() -> None:
    assert WireTimeout("x").hint == SessionLost().hint == faults.POWER_CYCLE
    assert DeviceGone().hint == "check cable, battery and switch"
    error = WireError("bad")
    assert (error.device, error.message) == ("camera", "bad") and error.hint


# Containers and datasets.


def test_a_message_has_up_to_five_parameters() -> None:
    assert (HEADER_BYTES, MAX_PARAMETERS) == (12, 5)
    five = pack_message(ContainerType.COMMAND, READ, 1, (1, 2, 3, 4, 5))
    assert len(five) == 32 and parse_message(five)[1] == 32
    assert parse_message(five)[0].parameters == (1, 2, 3, 4, 5)
    with pytest.raises(ValueError, match="0 parameters is no message"):
        pack_message(ContainerType.DATA, READ, 1)


@pytest.mark.parametrize(("kind", "known"), [(0, False), (1, True), (4, True), (5, False)])
def test_there_are_four_types_of_container(kind: int, known: bool) -> None:
    data = struct.pack("<IHHI", 12, kind, READ, 1)
    if known:
        assert parse_header(data).kind == kind and parse_header(data).length_bytes == 12
    else:
        with pytest.raises(WireError, match="not one of 1 to 4"):
            parse_header(data)


def test_a_length_is_left_open_where_it_does_not_fit() -> None:
    def length(payload_bytes: int) -> int:
        (found,) = struct.unpack_from("<I", pack_data_header(READ, 1, payload_bytes))
        return int(found)

    assert length(0xFFFFFFFF - 13) == 0xFFFFFFFE
    assert length(0xFFFFFFFF - 12) == length(1 << 40) == 0xFFFFFFFF


def test_a_body_that_says_little_is_an_ordinary_one() -> None:
    info = DeviceInfo("a", "b", "c", "d", (READ,))
    assert DeviceInfo.parse(info.pack()) == info
    assert (info.standard_version, info.functional_mode, info.vendor_extension) == (100, 0, "")
    assert (info.vendor_extension_id, info.vendor_extension_version) == (0, 0)
    assert info.events == info.properties == info.capture_formats == info.image_formats == ()


def test_a_size_that_does_not_fit_is_told_as_the_largest() -> None:
    packed = ObjectInfo(1, 2, 1 << 33, "a").pack()
    assert struct.unpack_from("<I", packed, 8) == (0xFFFFFFFF,)
    assert ObjectInfo.parse(packed) == ObjectInfo(1, 2, 0xFFFFFFFF, "a", 0, "")


def test_a_string_holds_254_units() -> None:
    assert pack_string("a" * 254)[0] == 255
    with pytest.raises(ValueError, match="holds 254 units, not 255"):
        pack_string("a" * 255)


def test_custom_functions_may_be_none_or_have_no_value() -> None:
    assert parse_custom_functions(struct.pack("<II", 8, 0)) == {}
    none = struct.pack("<7I", 28, 1, 1, 16, 1, 0x201, 0)
    assert parse_custom_functions(none) == {}
    with pytest.raises(WireError, match="says 3 bytes"):
        parse_custom_functions(struct.pack("<I", 3))
    with pytest.raises(WireError):
        parse_custom_functions(struct.pack("<I", 4))


# Events.


@pytest.mark.parametrize(
    ("kinds", "raw"), [((6,), True), ((1,), False), ((6, 1), False), ((6, 6), False), ((), False)]
)
def test_raw_alone_is_raw(kinds: tuple[int, ...], raw: bool) -> None:
    packed = struct.pack("<I", len(kinds))
    packed += b"".join(struct.pack("<4I", 16, kind, 0, 4) for kind in kinds)
    assert events.is_raw_only(packed) is raw


def test_names_end_on_whole_words() -> None:
    for name, size in (("a", 0x28 + 4), ("abc", 0x28 + 4), ("abcd", 0x28 + 8)):
        packed = ObjectAdded(1, 2, 3, name, True, 4, 5).pack()
        assert len(packed) == size and parse_events(packed) == [
            ObjectAdded(1, 2, 3, name, True, 4, 5)
        ]
    odd = ObjectAdded(1, 2, 3, "Ä", False).pack()
    (found,) = parse_events(odd)
    assert isinstance(found, ObjectAdded) and found.name == "?"


def test_formats_of_one_or_two_files_are_known() -> None:
    for entries in (0, 3):
        record = struct.pack("<6I", 24, 0xC18A, 0xD120, 3, 1, entries)
        with pytest.raises(WireError, match=f"an entry of {entries} files"):
            parse_events(record)
    assert parse_events(AvailList(Property.ISO).pack()) == [AvailList(0xD103, (), ())]


# Who holds a device, and who keeps it awake.


def test_processes_that_cannot_be_seen_hold_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = tmp_path / "node"
    for pid in ("5", "6", "x7"):
        (tmp_path / pid / "fd").mkdir(parents=True)
        (tmp_path / pid / "fd" / "3").symlink_to(node)
    for number in (0, 1, 2, 4, 5, 6):  # no links any more: they were closed meanwhile
        (tmp_path / "6" / "fd" / str(number)).touch()
    found = holders.list_holders(node, tmp_path)
    assert found == [holders.Holder(5, "unknown"), holders.Holder(6, "unknown")]
    assert holders.describe_holders(found, 7) == "unknown (process 5), unknown (process 6)"
    assert holders.build_node_path(1, 23, Path("/x")) == Path("/x/001/023")
    (tmp_path / "5" / "comm").write_bytes(b"caf\xe9\n")
    assert holders.list_holders(node, tmp_path)[0].name == "caf\ufffd"


def test_a_thread_ticks_until_it_is_stopped(caplog: pytest.LogCaptureFixture) -> None:
    assert PERIOD_S == 2.0  # cameras go to sleep after 30 s at the earliest
    ticked, ticks = threading.Event(), []

    def tick() -> None:
        ticks.append(threading.current_thread())
        if len(ticks) == 3:
            ticked.set()
        raise ConfigError("it is busy")

    alive = KeepAlive(tick, 0.001)
    assert ticked.wait(30.0)
    alive.stop()
    assert {(thread.name, thread.daemon) for thread in ticks} == {("pdcd-ptp-alive", True)}
    assert not ticks[0].is_alive() and "camera not kept awake" in caplog.text


def test_a_thread_may_be_stopped_from_within_its_own_tick() -> None:
    made: list[KeepAlive] = []
    stopped = threading.Event()
    began = threading.Event()

    def tick() -> None:
        began.wait(30.0)
        made[0].stop()
        stopped.set()

    made.append(KeepAlive(tick, 0.001))
    began.set()
    assert stopped.wait(30.0)
    made[0].stop()
