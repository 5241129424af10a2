"""A still-image interface on the USB: found, claimed, read, written, and every way it can refuse.

The device is scripted; the numbers of requests and descriptors are those of PIMA 15740, Annex D,
and of the USB specification.
"""

from __future__ import annotations

import array
import errno
from collections import deque
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest
import usb.core
import usb.util

from drivers.ptp import usb_port
from drivers.ptp.faults import (
    DeviceGone,
    EndpointStall,
    TransactionMismatch,
    WireFault,
    WireTimeout,
)
from drivers.ptp.usb_port import UsbPort, find_cameras, find_still_image_devices
from pdcd.errors import DeviceLost, DriverUnavailable

IN, OUT, INTERRUPT = 0x81, 0x02, 0x83

BULK_TYPE, INTERRUPT_TYPE = 2, 3

PACKET_B = 512


def error(number: int) -> usb.core.USBError:
    return usb.core.USBError("libusb says no", -9, number)


class Described(list[Any]):
    """Endpoints of an interface, which has attributes of its own."""


def interface(kind: tuple[int, int, int], number: int, endpoints: Any) -> Any:
    found = Described(
        SimpleNamespace(bEndpointAddress=address, bmAttributes=attributes, wMaxPacketSize=size)
        for address, attributes, size in endpoints
    )
    names = ("bInterfaceClass", "bInterfaceSubClass", "bInterfaceProtocol", "bInterfaceNumber")
    vars(found).update(zip(names, (*kind, number), strict=True))
    return found


ENDPOINTS = ((INTERRUPT, INTERRUPT_TYPE, 8), (IN, BULK_TYPE, 64), (OUT, BULK_TYPE, PACKET_B))


class Device:
    """Answers from a script, True where it ends; `done` is what was asked of it."""

    def __init__(
        self,
        *answers: Any,
        kind: tuple[int, int, int] = (6, 1, 1),
        number: tuple[int, int] = (0x04A9, 0x3145),
    ) -> None:
        self.idVendor, self.idProduct = number
        self.bus, self.address = 1, 7
        self.answers = deque(answers)
        self.done: list[Any] = []
        self.endpoints: Any = ENDPOINTS
        self.kind = kind
        self.fault: usb.core.USBError | None = None

    def __iter__(self) -> Any:
        if self.fault is not None:
            raise self.fault
        audio = interface((1, 1, 0), 0, ())
        return iter([[audio, interface(self.kind, 3, self.endpoints)]])

    def _answer(self, *what: Any, usually: Any = None) -> Any:
        self.done.append(what)
        answer = self.answers.popleft() if self.answers else usually
        if isinstance(answer, Exception):
            raise answer
        return usually if answer is None else answer

    def read(self, endpoint: int, data: Any, timeout_ms: int) -> Any:
        return self._answer("read", endpoint, timeout_ms, usually=len(data))

    def write(self, endpoint: int, data: bytes, timeout_ms: int) -> Any:
        return self._answer("write", endpoint, len(data), timeout_ms, usually=len(data))

    def ctrl_transfer(self, *what: Any) -> Any:
        return self._answer("control", *what, usually=b"")

    def clear_halt(self, endpoint: int) -> None:
        self._answer("clear", endpoint)

    def reset(self) -> None:
        self._answer("reset")


@pytest.fixture(autouse=True)
def released(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was claimed and released, in order."""
    done: list[str] = []
    monkeypatch.setattr(
        usb.util, "claim_interface", lambda device, number: done.append(f"claim {number}")
    )
    monkeypatch.setattr(usb.util, "dispose_resources", lambda device: done.append("dispose"))
    return done


def port_of(*answers: Any) -> tuple[UsbPort, Device]:
    device = Device(*answers)
    return UsbPort(device), device


def refusing(*args: Any) -> Callable[..., Any]:
    def refuse(*_: Any, **__: Any) -> Any:
        raise error(*args)

    return refuse


# Finding.


def test_cameras_are_found_by_their_interface_and_maker(monkeypatch: pytest.MonkeyPatch) -> None:
    canon, phone = Device(), Device(number=(0x18D1, 0x4EE5))
    printer, broken = Device(kind=(7, 1, 2)), Device()
    broken.fault = error(errno.EIO)
    plugged = [canon, phone, printer, broken]

    def look(*, find_all: bool, backend: object, custom_match: Callable[[Any], bool]) -> Any:
        assert find_all and backend == "libusb"
        return (device for device in plugged if custom_match(device))

    monkeypatch.setattr(usb.core, "find", look)
    assert find_cameras("libusb", None) == [canon]
    assert find_cameras("libusb", (0x18D1, 0x4EE5)) == [phone]
    assert find_cameras("libusb", (0x04A9, 0x4EE5)) == []
    assert find_still_image_devices("libusb") == [canon, phone]


# Claiming.


def test_the_interface_is_claimed_by_its_number(released: list[str]) -> None:
    port, _ = port_of()
    assert released == ["claim 3"] and port.packet_b == PACKET_B
    assert port.name == "04a9:3145 on bus 1 address 7"
    port.close()
    assert released == ["claim 3", "dispose"]


def test_what_is_no_still_image_device_is_not_claimed(released: list[str]) -> None:
    with pytest.raises(DeviceLost, match=r"no still-image interface \(set the camera to PTP"):
        UsbPort(Device(kind=(6, 1, 2)))
    for endpoints in (ENDPOINTS[:2], ENDPOINTS[::2], ((IN, INTERRUPT_TYPE, 8), ENDPOINTS[2])):
        device = Device()
        device.endpoints = endpoints
        with pytest.raises(DeviceLost, match="no pair of bulk endpoints"):
            UsbPort(device)
    assert released == []


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EBUSY, r"address 7 is held by process 41"),
        (errno.EACCES, r"address 7 may not be opened \(install pdcd's udev rule"),
        (errno.EPERM, r"address 7 may not be opened \(install pdcd's udev rule"),
        (errno.ENODEV, r"address 7: was unplugged or switched off \(check cable"),
        (errno.EIO, r"address 7: USB transfer failed: .*libusb says no.* \(switch the camera off"),
    ],
)
def test_a_device_that_may_not_be_claimed_is_let_go_and_says_why(
    released: list[str], monkeypatch: pytest.MonkeyPatch, number: int, words: str
) -> None:
    monkeypatch.setattr(usb.util, "claim_interface", refusing(number))
    monkeypatch.setattr(usb_port, "list_holders", lambda node: [node])
    monkeypatch.setattr(usb_port, "describe_holders", lambda who, mine: "process 41")
    with pytest.raises(DeviceLost, match=words) as caught:
        UsbPort(Device())
    assert released == ["dispose"]
    assert caught.value.device == "camera" and caught.value.hint
    assert not isinstance(caught.value, WireFault)


# Transfers.


@pytest.mark.parametrize(("seconds", "timeout_ms"), [(0.0104, 10), (-1.0, 1)])
def test_a_read_says_how_much_came(seconds: float, timeout_ms: int) -> None:
    """0 would mean for ever to libusb."""
    port, device = port_of(37)
    assert port.read_into(array.array("B", bytes(512)), seconds) == 37
    assert device.done == [("read", IN, timeout_ms)]


@pytest.mark.parametrize(("size", "packets"), [(511, [511]), (512, [512, 0]), (1024, [1024, 0])])
def test_a_write_of_whole_packets_is_ended_by_an_empty_one(size: int, packets: list[int]) -> None:
    port, device = port_of()
    port.write(bytes(size), 1.0)
    assert device.done == [("write", OUT, count, 200) for count in packets]


def test_a_write_that_was_not_taken_whole_is_out_of_step() -> None:
    port, _ = port_of(99)
    with pytest.raises(TransactionMismatch, match="only 99 of 100 bytes"):
        port.write(bytes(100), 1.0)


def read(port: UsbPort) -> object:
    return port.read_into(array.array("B", bytes(64)), 1.0)


def write(port: UsbPort) -> object:
    port.write(bytes(64), 1.0)
    return 64


@pytest.mark.parametrize("transfer", [read, write])
def test_a_halted_endpoint_is_cleared_once_and_the_transfer_made_again(
    transfer: Callable[[UsbPort], object],
) -> None:
    port, device = port_of(error(errno.EPIPE))
    assert transfer(port) == 64
    endpoint = IN if transfer is read else OUT
    assert [what[:2] for what in device.done] == [
        (transfer.__name__, endpoint), ("clear", endpoint), (transfer.__name__, endpoint),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("answers", "kind", "count"),
    [
        ([error(errno.ETIMEDOUT)] * 5, WireTimeout, 5),
        ([error(errno.ENODEV)], DeviceGone, 1),
        ([error(errno.EIO)], TransactionMismatch, 1),
        ([error(errno.EPIPE), None, error(errno.EPIPE)], EndpointStall, 3),
        ([error(errno.EPIPE), None, *[error(errno.ETIMEDOUT)] * 5], WireTimeout, 7),
        ([error(errno.EPIPE), error(errno.ENODEV)], DeviceGone, 2),
    ],
)
def test_every_other_fault_is_told_by_its_kind(
    answers: list[Any], kind: type[WireFault], count: int
) -> None:
    port, device = port_of(*answers)
    with pytest.raises(kind):
        read(port)
    assert len(device.done) == count


# Class requests.


def test_a_transaction_is_given_up_by_its_number() -> None:
    port, device = port_of()
    port.cancel(0x01020304)
    assert device.done == [("control", 0x21, 0x64, 0, 3, bytes.fromhex("0140 04030201"), 800)]


def test_a_reset_of_the_device_lets_both_endpoints_go_on() -> None:
    port, device = port_of()
    port.device_reset()
    assert device.done == [("control", 0x21, 0x66, 0, 3, b"", 800), ("clear", IN), ("clear", OUT)]


@pytest.mark.parametrize(
    ("reply", "code", "cleared"),
    [
        ("0400 0120", 0x2001, []),
        ("0800 1f20 81000000", 0x201F, [0x81]),
        ("0c00 1f20 81000000 02000000", 0x201F, [0x81, 0x02]),
        ("0a00 1f20 81000000 0200", 0x201F, [0x81]),  # the rest is no endpoint
    ],
)
def test_the_status_of_a_device_names_its_halted_endpoints(
    reply: str, code: int, cleared: list[int]
) -> None:
    port, device = port_of(bytes.fromhex(reply))
    assert port.status() == code
    first, *others = device.done
    assert first[:5] == ("control", 0xA1, 0x67, 0, 3) and first[5] >= 12 and first[6] == 800
    assert others == [("clear", endpoint) for endpoint in cleared]


@pytest.mark.parametrize("size", [0, 3])
def test_a_status_that_is_too_short_is_out_of_step(size: int) -> None:
    port, _ = port_of(bytes(size))
    with pytest.raises(TransactionMismatch, match=f"status of {size} bytes"):
        port.status()


@pytest.mark.parametrize(
    "ask", [UsbPort.status, UsbPort.device_reset, lambda port: port.cancel(5), UsbPort.usb_reset]
)
def test_requests_that_fail_are_faults_of_the_wire(ask: Callable[[UsbPort], object]) -> None:
    port, _ = port_of(error(errno.ETIMEDOUT))
    with pytest.raises(WireTimeout):
        ask(port)


# The end.


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (None, None),
        (errno.ENODEV, None),  # it comes back anew
        (errno.ENOENT, None),
        (errno.EIO, TransactionMismatch),
    ],
)
def test_a_device_that_is_reset_or_gone_is_released_in_any_case(
    released: list[str],
    monkeypatch: pytest.MonkeyPatch,
    number: int | None,
    kind: type[WireFault] | None,
) -> None:
    port, device = port_of(*([] if number is None else [error(number)]))
    with pytest.raises(kind) if kind else nullcontext():
        port.usb_reset()
    assert device.done == [("reset",)] and released[-1] == "dispose"
    if number is not None:
        monkeypatch.setattr(usb.util, "dispose_resources", refusing(number))
        with pytest.raises(kind) if kind else nullcontext():
            port.close()


@pytest.mark.parametrize(
    ("fault", "kind", "words"),
    [
        (usb.core.NoBackendError("none"), DriverUnavailable, "install libusb-1.0"),
        (error(errno.EIO), DeviceLost, "cannot look at the USB: .*see dmesg"),
    ],
)
def test_a_machine_that_cannot_look_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, fault: Exception, kind: type[Exception], words: str
) -> None:
    def refuse(**_: Any) -> Any:
        raise fault

    monkeypatch.setattr(usb.core, "find", refuse)
    with pytest.raises(kind, match=words):
        find_cameras(None, None)
