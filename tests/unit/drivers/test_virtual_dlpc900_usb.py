"""Virtual DLPC900s on their USB, by pyusb itself: who holds them, how fast reports go, and what
goes wrong on the way."""

from __future__ import annotations

import array
import errno
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import usb.core
import usb.util

from drivers.virtual_dlpc900 import (
    PLANES_BY_TI,
    DmdRegister,
    RefusalCode,
    VirtualDlpc900,
    VirtualDmdBus,
    VirtualDmdFault,
    VirtualDmdOptions,
    choose_dmd_model,
)
from pdcd.bench.clock import VirtualClock
from tests.dmd_client import CONFIGURE, MODE, RUN, START, STOP, DmdClient, entry_bytes

PLANES = np.random.default_rng(2).random((30, 4, 6)) < 0.5
ENTRIES = [entry_bytes(n, 105, 0, n // 24, n % 24, wait=n == 0) for n in range(30)]


class Bus:
    """Devices "A1", "A2" ... on one USB."""

    def __init__(
        self,
        count: int = 1,
        faults: Sequence[VirtualDmdFault] = (),
        options: VirtualDmdOptions | None = None,
        kernel_driver: bool = True,
    ) -> None:
        self.clock = VirtualClock()
        self.devices = [
            VirtualDlpc900(
                self.clock, choose_dmd_model((6, 4)), f"A{n + 1}", options, faults if not n else ()
            )
            for n in range(count)
        ]
        self.usb = VirtualDmdBus(*self.devices, kernel_driver=kernel_driver)

    def client(self, serial: str = "A1") -> DmdClient:
        return DmdClient(self.usb, serial)

    @property
    def ms(self) -> float:
        return self.clock.now_ns() * 1e-6


def fails(number: int) -> Any:
    return pytest.raises(usb.core.USBError, match=f"Errno {number}")


def test_pyusb_finds_them_and_tells_them_apart() -> None:
    bus = Bus(3)
    found = list(usb.core.find(find_all=True, backend=bus.usb, idVendor=0x0451, idProduct=0xC900))
    assert [device.serial_number for device in found] == ["A1", "A2", "A3"]
    assert {device.product for device in found} == {"DLPC900"}
    assert len({(device.bus, device.address) for device in found}) == 3
    ((interface,),) = found[0]
    assert (interface.bInterfaceNumber, interface.bInterfaceClass) == (0, 3)
    ends = [(end.bEndpointAddress, end.bmAttributes & 3, end.wMaxPacketSize) for end in interface]
    assert ends == [(0x81, 3, 64), (0x01, 3, 64)]
    assert usb.core.find(backend=bus.usb, idVendor=0x04A9) is None
    assert usb.util.get_string(found[0], 1) == "Texas Instruments"


def test_the_kernel_holds_them_until_it_is_asked_to_let_go() -> None:
    bus = Bus()
    device = usb.core.find(backend=bus.usb)
    assert device.is_kernel_driver_active(0)
    with fails(errno.EBUSY):
        device.set_configuration()
    with fails(errno.EBUSY):
        device.write(1, bytes(64))
    device.detach_kernel_driver(0)
    with fails(errno.ENOENT):
        device.detach_kernel_driver(0)
    device.set_configuration()
    assert device.write(1, bytes(64)) == 64
    with fails(errno.EBUSY):
        device.attach_kernel_driver(0)  # it is claimed
    usb.util.release_interface(device, 0)
    device.attach_kernel_driver(0)
    assert device.is_kernel_driver_active(0)
    free = Bus(kernel_driver=False)
    client = DmdClient(free.usb, detach=False)
    client.run(STOP)


def test_a_claim_is_for_one() -> None:
    bus = Bus(2)
    client = bus.client()
    client.run(STOP)
    other = bus.client()
    with fails(errno.EBUSY):
        other.run(STOP)
    bus.client("A2").run(STOP)
    usb.util.dispose_resources(client.device)
    other.run(STOP)
    bus.usb.held_by_other.add("A2")
    with fails(errno.EBUSY):
        bus.client("A2").run(STOP)


def test_one_report_a_millisecond_for_each_device() -> None:
    bus = Bus(2)
    one, two = bus.client("A1"), bus.client("A2")
    begun = bus.ms
    one.run(STOP)
    assert bus.ms - begun == 2, "there and back"
    begun = bus.ms
    one.send(0x1A2B, bytes(506), flags=0)
    assert bus.ms - begun == 8, "512 bytes"
    fast = Bus(options=VirtualDmdOptions(report_s=0.000125))
    client, begun = fast.client(), fast.ms
    client.run(STOP)
    assert fast.ms - begun == 0.25
    two.run(STOP)
    assert [device.reports for device in bus.devices] == [10, 2]


def test_a_report_is_whole_or_lost() -> None:
    bus = Bus()
    client = bus.client()
    client.send(MODE, flags=0xC0)
    with fails(errno.EOVERFLOW):
        client.device.read(0x81, 63)
    begun = bus.ms
    with pytest.raises(usb.core.USBTimeoutError):
        client.device.read(0x81, 64, 200)
    assert bus.ms - begun == 200
    with fails(errno.ENOENT):
        bus.usb.intr_write(claimed(bus), 0x02, 0, array.array("B", bytes(64)), 100)


def claimed(bus: Bus) -> Any:
    usb_handle = bus.usb.open_device(next(bus.usb.enumerate_devices()))
    bus.usb._claimed[usb_handle.address] = usb_handle
    return usb_handle


def test_old_replies_are_gone_unless_they_are_kept() -> None:
    """pyusb drops what nobody fetched; hidapi's queue has it."""
    for kept, sequences in ((1, [3]), (8, [1, 2, 3])):
        bus = Bus(options=VirtualDmdOptions(replies_kept=kept))
        client = bus.client()
        for number in (1, 2, 3):
            client.send(RUN, bytes([STOP]), flags=0x40, sequence=number)
        assert [client.fetch()[1] for _ in sequences] == sequences
        with pytest.raises(usb.core.USBTimeoutError):
            client.fetch(50)


def test_stale_replies_wait_before_the_first_command() -> None:
    bus = Bus(options=VirtualDmdOptions(replies_kept=8))
    client = bus.client()
    bus.devices[0].leave_stale(200, 201)
    client.send(MODE, flags=0xC0, sequence=5)
    assert [client.fetch()[1] for _ in range(3)] == [200, 201, 5]


@pytest.mark.parametrize(
    ("kind", "done", "answered"),
    [("deaf", False, False), ("mute", True, False), ("error", False, True)],
)
def test_commands_that_are_not_done_or_not_answered(kind: Any, done: bool, answered: bool) -> None:
    fault = VirtualDmdFault(kind, DmdRegister.MODE, first=2, code=RefusalCode.DEVICE_FAILURE)
    bus = Bus(faults=[fault])
    client = bus.client()
    client.begin()
    if answered:
        assert client.refuses(MODE, b"\0") == 2
    else:
        client.send(MODE, b"\0", flags=0x40)
        with pytest.raises(usb.core.USBTimeoutError):
            client.fetch(100)
    assert client.read(MODE) == (b"\0" if done else b"\3")


def test_a_reply_that_comes_after_the_next_one() -> None:
    bus = Bus(
        faults=[VirtualDmdFault("late", DmdRegister.MODE)],
        options=VirtualDmdOptions(replies_kept=2),
    )
    client = bus.client()
    client.send(MODE, flags=0xC0, sequence=1)
    client.send(0x0200, flags=0xC0, sequence=2)
    assert [client.fetch()[1:] for _ in range(2)] == [(2, b"\0"), (1, b"\1")]


@pytest.mark.parametrize("seconds", [0.5, 1.5])
def test_a_device_that_is_busy(seconds: float) -> None:
    bus = Bus(faults=[VirtualDmdFault("busy", DmdRegister.MODE, seconds=seconds)])
    client = bus.client()
    client.run(STOP)
    client.send(MODE, b"\3", flags=0x40)
    begun = bus.ms
    if seconds < 1.0:
        assert client.fetch()[0] == 0x40
        assert bus.ms - begun == 501
        return
    with pytest.raises(usb.core.USBTimeoutError):
        client.fetch()
    assert bus.ms - begun == 1000
    with pytest.raises(usb.core.USBTimeoutError):
        client.device.write(1, bytes(64), 100)
    assert bus.ms - begun == 1100
    assert client.fetch()[0] == 0x40 and bus.ms - begun == 1501


def upload(client: DmdClient) -> None:
    client.upload(PLANES, ENTRIES, PLANES_BY_TI)
    client.run(START)


def test_the_plug_is_pulled_at_any_report() -> None:
    """Each report of an upload is lost once; put back, the device takes the whole of another."""
    bus = Bus()
    upload(bus.client())
    count = bus.devices[0].reports
    assert count > 80
    for lost in range(1, count + 1):
        bus = Bus()
        device = bus.devices[0]
        device.unplug_at = lost
        client = bus.client()
        with fails(errno.ENODEV):
            upload(client)
        assert device.reports == lost and not device.plugged
        assert list(bus.usb.enumerate_devices()) == []
        with fails(errno.ENODEV):
            client.run(STOP)
        device.replug()
        with fails(errno.ENODEV):
            client.run(STOP)  # it has another address now
        again = bus.client()
        upload(again)
        begun_ns = bus.clock.now_ns()
        device.drive_line(1, True, begun_ns)
        bus.clock.sleep_until_ns(begun_ns + 10**8)
        shown = [
            plane.words >> plane.bit & 1
            for _, plane in device.list_changes(begun_ns, bus.clock.now_ns())
            if plane is not None
        ]
        assert np.array_equal(shown[:30], PLANES)


def test_a_sequence_goes_on_when_the_plug_is_out() -> None:
    """The mirrors have a power supply of their own."""
    bus = Bus()
    device = bus.devices[0]
    upload(bus.client())
    device.unplug()
    begun_ns = bus.clock.now_ns()
    device.drive_line(1, True, begun_ns)
    assert len(device.list_changes(begun_ns, begun_ns + 10**7)) > 30


@pytest.mark.parametrize("kind", ["unplug", "reset"])
def test_a_device_that_goes_at_a_command(kind: Any) -> None:
    bus = Bus(faults=[VirtualDmdFault(kind, DmdRegister.LUT_CONFIGURE)])
    client = bus.client()
    with fails(errno.ENODEV):
        client.upload(PLANES, ENTRIES, PLANES_BY_TI)
    device = bus.devices[0]
    assert not device.plugged
    if kind == "unplug":
        device.replug()
        again = bus.client()
        assert again.read(CONFIGURE) == bytes(6), "it was not done"
        assert again.read(MODE) == b"\3"
        return
    bus.clock.sleep_until_ns(bus.clock.now_ns() + 5 * 10**9)
    assert bus.client().read(MODE) == b"\1"


def test_a_reset_of_the_port_ends_claims_and_leaves_the_mirrors_alone() -> None:
    bus = Bus()
    client = bus.client()
    upload(client)
    client.device.reset()
    with fails(errno.ENODEV):
        client.run(STOP)
    again = usb.core.find(backend=bus.usb)
    assert again.is_kernel_driver_active(0)
    assert bus.client().read(0x1A0C) == b"\2", "it still waits"


def test_half_a_command_is_forgotten_with_the_plug() -> None:
    bus = Bus()
    client = bus.client()
    whole = struct.pack("<BBHH", 0x40, 1, 100, 0x1A32) + bytes(98)
    client.device.write(1, whole[:64])
    bus.devices[0].unplug()
    bus.devices[0].replug()
    bus.client().run(STOP)
