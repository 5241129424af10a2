"""What backends of virtual USB devices have in common: errors as libusb raises them, and
descriptors."""

from __future__ import annotations

import array
import errno
import struct
from enum import IntEnum
from types import SimpleNamespace
from typing import Any, ClassVar

import usb.backend
import usb.core

STRING_DESCRIPTOR = 3
_ENGLISH = 0x0409


class LibusbCode(IntEnum):
    """Codes of libusb's errors."""

    IO = -1
    NO_DEVICE = -4
    NOT_FOUND = -5
    BUSY = -6
    TIMEOUT = -7
    OVERFLOW = -8
    PIPE = -9


_ERRORS = {
    LibusbCode.IO: ("Input/Output Error", errno.EIO),
    LibusbCode.NO_DEVICE: ("No such device (it may have been disconnected)", errno.ENODEV),
    LibusbCode.NOT_FOUND: ("Entity not found", errno.ENOENT),
    LibusbCode.BUSY: ("Resource busy", errno.EBUSY),
    LibusbCode.OVERFLOW: ("Overflow", errno.EOVERFLOW),
    LibusbCode.PIPE: ("Pipe error", errno.EPIPE),
}


def make_usb_error(code: LibusbCode) -> usb.core.USBError:
    """The error with that code, its text and errno."""
    if code is LibusbCode.TIMEOUT:
        return usb.core.USBTimeoutError("Operation timed out", int(code), errno.ETIMEDOUT)
    text, number = _ERRORS[code]
    return usb.core.USBError(text, int(code), number)


def make_string_descriptor(index: int, texts: tuple[str, ...]) -> bytes:
    """A string descriptor: index 0 gives the languages, the indices after it the texts in order.

    Raises USBError (pipe halted) for an index that does not exist.
    """
    if index == 0:
        return struct.pack("<BBH", 4, STRING_DESCRIPTOR, _ENGLISH)
    if index > len(texts):
        raise make_usb_error(LibusbCode.PIPE)
    units = texts[index - 1].encode("utf-16-le")
    return bytes([2 + len(units), STRING_DESCRIPTOR]) + units


def copy_reply(reply: bytes, buffer: array.array[int]) -> int:
    """Copy as much of a reply as the buffer holds; returns the number of bytes."""
    count = min(len(reply), len(buffer))
    memoryview(buffer).cast("B")[:count] = reply[:count]
    return count


class OneInterfaceUsb(usb.backend.IBackend):  # type: ignore[misc]  # pyusb has no types
    """A USB without hubs, whose devices have one configuration and one interface each.

    interface_class : class, subclass and protocol. class_bytes : length of the class's own
    descriptors. endpoints : address, kind, bytes of a packet and interval of each.
    """

    interface_class: ClassVar[tuple[int, int, int]]
    class_bytes: ClassVar[int] = 0
    endpoints: ClassVar[tuple[tuple[int, int, int, int], ...]]

    def get_parent(self, _dev: Any) -> None:
        """None: each device is on the root hub."""
        return

    def get_configuration_descriptor(self, _dev: Any, config: int) -> Any:
        """The only configuration."""
        _require_first(config)
        length = 18 + self.class_bytes + 7 * len(self.endpoints)
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=length, bNumInterfaces=1,
            bConfigurationValue=1, iConfiguration=0, bmAttributes=0xC0, bMaxPower=1,
            extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, _dev: Any, intf: int, alt: int, config: int) -> Any:
        """The only interface."""
        _require_first(config, intf, alt)
        kind, subclass, protocol = self.interface_class
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0,
            bNumEndpoints=len(self.endpoints), bInterfaceClass=kind, bInterfaceSubClass=subclass,
            bInterfaceProtocol=protocol, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, _dev: Any, ep: int, intf: int, alt: int, config: int) -> Any:
        """One of the endpoints."""
        _require_first(config, intf, alt)
        address, kind, size, interval = self.endpoints[ep]
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=address, bmAttributes=kind,
            wMaxPacketSize=size, bInterval=interval, bRefresh=0, bSynchAddress=0,
            extra_descriptors=[],
        )  # fmt: skip

    def get_configuration(self, dev_handle: Any) -> int:
        """The only one."""
        self._alive(dev_handle)
        return 1

    def set_interface_altsetting(self, dev_handle: Any, _intf: int, _alt: int) -> None:
        """Nothing changes."""
        self._alive(dev_handle)

    def _alive(self, handle: Any) -> None:
        """Raise USBError unless the device of that handle is there."""


def make_device_descriptor(
    ids: tuple[int, int],
    place: tuple[int, tuple[int, ...]],
    *,
    usb_version: int,
    version: int,
    speed: int,
) -> Any:
    """A device's descriptor. ids : vendor and product. place : its address, and its ports from the
    root hub on."""
    (vendor, product), (address, ports) = ids, place
    return SimpleNamespace(
        bLength=18, bDescriptorType=1, bcdUSB=usb_version, bDeviceClass=0, bDeviceSubClass=0,
        bDeviceProtocol=0, bMaxPacketSize0=64, idVendor=vendor, idProduct=product,
        bcdDevice=version, iManufacturer=1, iProduct=2, iSerialNumber=3, bNumConfigurations=1,
        bus=1, address=address, port_number=ports[-1], port_numbers=ports, speed=speed,
    )  # fmt: skip


def _require_first(*indices: int) -> None:
    """Raise IndexError unless all are 0: there is one of each, and pyusb counts up until then."""
    if any(indices):
        raise IndexError(indices)
