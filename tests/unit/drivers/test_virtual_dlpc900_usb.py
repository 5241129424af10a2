"""Virtual DLPC900s on their USB, by pyusb itself: who holds them, how fast reports go, and what
goes wrong on the way."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import usb.core
import usb.util

from drivers.virtual_dlpc900 import (
    PLANES_BY_TI,
    VirtualDlpc900,
    VirtualDmdBus,
    VirtualDmdFault,
    VirtualDmdOptions,
    choose_dmd_model,
)
from pdcd.bench.clock import VirtualClock
from tests.dmd_client import START, STOP, DmdClient, entry_bytes

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
