"""Virtual DMD controllers on one USB: a pyusb backend that real pyusb code drives unchanged.

Give it to ``usb.core.find(find_all=True, backend=...)``. Errors are those that libusb raises on
Linux, where the kernel's HID driver holds each device until it is detached. Each report takes time
in either direction, for each device separately; an interrupt transfer of several reports goes
packet by packet. Not modelled: hubs, power, HID's own descriptors and control requests.
"""

from __future__ import annotations

import array
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, Generic, TypeVar

from ..virtual_usb import (
    STRING_DESCRIPTOR,
    LibusbCode,
    OneInterfaceUsb,
    copy_reply,
    make_device_descriptor,
    make_string_descriptor,
    make_usb_error,
)
from .plug import ReportController
from .reports import USB_REPORT_LENGTH

_IN, _OUT = 0x81, 0x01
_FIRST_ADDRESS = 20
_FULL_SPEED, _INTERRUPT, _HID = 2, 3, 3
_Device = TypeVar("_Device", bound=ReportController)
_LONG_MS = 10_000
"""How long a transfer without a time-out waits; libusb would wait for ever."""


class _Opened:
    """An opened device; useless once it has come back under another address."""

    def __init__(self, device: ReportController, address: int) -> None:
        self.device, self.address = device, address


class VirtualDmdBus(OneInterfaceUsb, Generic[_Device]):
    """A USB with devices on it. Its methods are those that pyusb documents of a backend.

    kernel_driver : whether the kernel takes hold of devices that are plugged in.
    held_by_other : serial numbers of devices that another program has claimed.
    """

    interface_class, class_bytes = (_HID, 0, 0), 9
    endpoints = tuple((end, _INTERRUPT, USB_REPORT_LENGTH, 1) for end in (_IN, _OUT))

    def __init__(self, *devices: _Device, kernel_driver: bool = True) -> None:
        super().__init__()
        self.devices = devices
        self.kernel_driver = kernel_driver
        self.held_by_other: set[str] = set()
        self._detached: set[int] = set()
        self._claimed: dict[int, _Opened] = {}
        self._free_ns: dict[int, int] = {}

    def address_of(self, device: ReportController) -> int:
        """A device's address; it changes each time the device comes back."""
        turn = len(self.devices) * device.plugged_again
        return _FIRST_ADDRESS + self.devices.index(device) + turn

    # What devices say of themselves

    def enumerate_devices(self) -> Iterator[Any]:
        """Those that are plugged in."""
        for device in self.devices:
            if device.plugged:
                yield SimpleNamespace(device=device, address=self.address_of(device))

    def get_device_descriptor(self, dev: Any) -> Any:
        """USB 1.1, full speed."""
        place = dev.address, (1 + self.devices.index(dev.device),)
        return make_device_descriptor(
            dev.device.usb_ids, place, usb_version=0x0110, version=0x0200, speed=_FULL_SPEED
        )

    # Opening and claiming

    def open_device(self, dev: Any) -> _Opened:
        """Open; ENODEV when it is not plugged in, or has another address by now."""
        handle = _Opened(dev.device, dev.address)
        self._alive(handle)
        return handle

    def close_device(self, dev_handle: _Opened) -> None:
        """Close, and release what was claimed."""
        if self._claimed.get(dev_handle.address) is dev_handle:
            del self._claimed[dev_handle.address]

    def set_configuration(self, dev_handle: _Opened, _config_value: int) -> None:
        """Nothing changes; EBUSY while the kernel or somebody else has the interface."""
        self._alive(dev_handle)
        self._take_hold(dev_handle)

    def claim_interface(self, dev_handle: _Opened, _intf: int) -> None:
        """Claim; EBUSY while the kernel or somebody else has it."""
        self._alive(dev_handle)
        self._take_hold(dev_handle)
        self._claimed[dev_handle.address] = dev_handle

    def _take_hold(self, handle: _Opened) -> None:
        holder = self._claimed.get(handle.address)
        other = handle.device.serial in self.held_by_other
        if other or holder not in (None, handle) or self.is_kernel_driver_active(handle, 0):
            raise make_usb_error(LibusbCode.BUSY)

    def release_interface(self, dev_handle: _Opened, _intf: int) -> None:
        """Release; ENOENT when it was not claimed."""
        self._alive(dev_handle)
        if self._claimed.get(dev_handle.address) is not dev_handle:
            raise make_usb_error(LibusbCode.NOT_FOUND)
        del self._claimed[dev_handle.address]

    def is_kernel_driver_active(self, dev_handle: _Opened, _intf: int) -> bool:
        """Whether the kernel holds it."""
        self._alive(dev_handle)
        return self.kernel_driver and dev_handle.address not in self._detached

    def detach_kernel_driver(self, dev_handle: _Opened, intf: int) -> None:
        """Have the kernel let go; ENOENT when it does not hold it."""
        if not self.is_kernel_driver_active(dev_handle, intf):
            raise make_usb_error(LibusbCode.NOT_FOUND)
        self._detached.add(dev_handle.address)

    def attach_kernel_driver(self, dev_handle: _Opened, intf: int) -> None:
        """Have the kernel hold it again; EBUSY while it does, or while somebody has claimed it."""
        active = self.is_kernel_driver_active(dev_handle, intf)
        if active or dev_handle.address in self._claimed:
            raise make_usb_error(LibusbCode.BUSY)
        self._detached.discard(dev_handle.address)

    def clear_halt(self, dev_handle: _Opened, _ep: int) -> None:
        """Endpoints never halt."""
        self._alive(dev_handle)

    def reset_device(self, dev_handle: _Opened) -> None:
        """Reset the port: it comes back under another address, and goes on as it was."""
        self._alive(dev_handle)
        dev_handle.device.unplug()
        dev_handle.device.replug()

    # Transfers

    def intr_write(
        self, dev_handle: _Opened, ep: int, _intf: int, data: array.array[int], timeout: int
    ) -> int:
        """Send reports; a time-out while the device takes none."""
        device, content = self._claim_of(dev_handle, ep, _OUT), bytes(data)
        for at in range(0, len(content), USB_REPORT_LENGTH):
            self._spend_report(dev_handle, timeout)
            device.write_report(content[at : at + USB_REPORT_LENGTH])
        return len(content)

    def intr_read(
        self, dev_handle: _Opened, ep: int, _intf: int, buff: array.array[int], timeout: int
    ) -> int:
        """Fetch a report; if there is none, a time-out after `timeout` ms."""
        device, clock = self._claim_of(dev_handle, ep, _IN), dev_handle.device.clock
        late_ns = clock.now_ns() + (timeout or _LONG_MS) * 1_000_000
        clock.sleep_until_ns(min(device.hung_until_ns, late_ns))
        report = device.read_report() if device.hung_until_ns <= late_ns else None
        if report is None:
            clock.sleep_until_ns(late_ns)
            raise make_usb_error(LibusbCode.TIMEOUT)
        self._spend_report(dev_handle, timeout)
        if len(buff) < len(report):
            raise make_usb_error(LibusbCode.OVERFLOW)
        memoryview(buff).cast("B")[: len(report)] = report
        return len(report)

    def ctrl_transfer(
        self,
        dev_handle: _Opened,
        bmRequestType: int,  # noqa: N803 - pyusb's names
        bRequest: int,  # noqa: N803
        wValue: int,  # noqa: N803
        wIndex: int,  # noqa: N803
        data: array.array[int],
        timeout: int,
    ) -> int:
        """String descriptors."""
        self._alive(dev_handle)
        if (bmRequestType, bRequest, wValue >> 8) != (0x80, 6, STRING_DESCRIPTOR):
            raise make_usb_error(LibusbCode.PIPE)
        device = dev_handle.device
        texts = "Texas Instruments", device.product, device.serial
        return copy_reply(make_string_descriptor(wValue & 0xFF, texts), data)

    def _claim_of(self, handle: _Opened, ep: int, wanted: int) -> ReportController:
        """The device of a handle; checks that it is there and claimed, and that `ep` is right."""
        self._alive(handle)
        if self._claimed.get(handle.address) is not handle:
            raise make_usb_error(LibusbCode.IO)
        if ep != wanted:
            raise make_usb_error(LibusbCode.NOT_FOUND)
        return handle.device

    def _alive(self, handle: _Opened) -> None:
        if not handle.device.plugged or handle.address != self.address_of(handle.device):
            raise make_usb_error(LibusbCode.NO_DEVICE)

    def _spend_report(self, handle: _Opened, timeout_ms: int) -> None:
        """Wait while one report is transferred, after this device's earlier ones."""
        device = handle.device
        now_ns, free_ns = device.clock.now_ns(), self._free_ns.get(handle.address, 0)
        until_ns = max(now_ns, free_ns, device.hung_until_ns) + round(device.report_s * 1e9)
        late_ns = now_ns + (timeout_ms or _LONG_MS) * 1_000_000
        device.clock.sleep_until_ns(min(until_ns, late_ns))
        if until_ns > late_ns:
            raise make_usb_error(LibusbCode.TIMEOUT)
        self._free_ns[handle.address] = until_ns
        device.count_report()
        self._alive(handle)
