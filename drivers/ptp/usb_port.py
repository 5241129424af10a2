"""A still-image device on the USB: found, claimed, read and written through pyusb.

It only moves bytes; `drivers.ptp.transport` knows what they mean. The still-image class
(PIMA 15740) has a bulk endpoint each way, and four requests on the control endpoint.
"""

from __future__ import annotations

import array
import errno
import os
from collections.abc import Callable
from typing import Any

import usb.core
import usb.util

from pdcd.driver import DeviceLost, DriverUnavailable

from .codes import ClassRequest
from .faults import (
    DEVICE,
    EndpointStall,
    TransactionMismatch,
    WireFault,
    WireTimeout,
    to_wire_fault,
)
from .holders import HINT, build_node_path, describe_holders, list_holders

_CANON = 0x04A9
_STILL_IMAGE = (6, 1, 1)
"""Class, subclass and protocol of the interface."""

_CLASS_OUT, _CLASS_IN = 0x21, 0xA1
_CONTROL_S = 0.8
_STEP_MS = 200
"""Longest transfer between two checks whether it is still wanted."""
_STATUS_B = 64
_WENT = (errno.ENODEV, errno.ENOENT)

PERMISSION_HINT = "install pdcd's udev rule, be in its group, and plug the camera in again"


def find_cameras(backend: object, usb_id: tuple[int, int] | None) -> list[Any]:
    """The devices with a still-image interface: of this vendor and product, or all of Canon's.

    `backend` is a pyusb backend; None takes the machine's libusb. Raises DriverUnavailable when
    there is none.
    """

    def wanted(device: Any) -> bool:
        if usb_id is None:
            return bool(device.idVendor == _CANON)
        return (device.idVendor, device.idProduct) == usb_id

    return find_still_image_devices(backend, wanted)


def find_still_image_devices(
    backend: object, wanted: Callable[[Any], bool] = lambda _: True
) -> list[Any]:
    """All devices with a still-image interface, including telephones; raises as `find_cameras`."""

    def matches(device: Any) -> bool:
        return wanted(device) and _interface(device) is not None

    try:
        return list(usb.core.find(find_all=True, backend=backend, custom_match=matches))
    except usb.core.NoBackendError as err:
        raise DriverUnavailable(
            "libusb is not installed", device=DEVICE, hint="install libusb-1.0"
        ) from err
    except usb.core.USBError as err:
        raise DeviceLost(f"cannot look at the USB: {err}", device=DEVICE, hint="see dmesg") from err


def describe_device(device: Any) -> str:
    """Vendor, product and place of a device, for messages."""
    return (
        f"{device.idVendor:04x}:{device.idProduct:04x} on bus {device.bus} address {device.address}"
    )


class UsbPort:
    """One claimed still-image interface.

    Raises DeviceLost when the device may not be opened, naming who holds it; every transfer raises
    a `WireFault`. A halted endpoint is cleared once and the transfer tried again.

    look : called at least every `_STEP_MS`; whatever it raises ends the wait.
    """

    def __init__(self, device: Any, look: Callable[[], None] = lambda: None) -> None:
        self._device = device
        self._look = look
        interface = _interface(device)
        if interface is None:
            raise DeviceLost(
                f"{describe_device(device)} has no still-image interface",
                device=DEVICE,
                hint="set the camera to PTP (normal PC connection)",
            )
        self._interface = int(interface.bInterfaceNumber)
        endpoints = {
            usb.util.endpoint_direction(e.bEndpointAddress): e
            for e in interface
            if usb.util.endpoint_type(e.bmAttributes) == usb.util.ENDPOINT_TYPE_BULK
        }
        try:
            self._in = int(endpoints[usb.util.ENDPOINT_IN].bEndpointAddress)
            self._out = int(endpoints[usb.util.ENDPOINT_OUT].bEndpointAddress)
            self.packet_b = int(endpoints[usb.util.ENDPOINT_OUT].wMaxPacketSize)
        except KeyError as err:
            raise DeviceLost(
                f"{describe_device(device)} has no pair of bulk endpoints", device=DEVICE
            ) from err
        try:
            usb.util.claim_interface(device, self._interface)
        except usb.core.USBError as err:
            usb.util.dispose_resources(device)
            raise _refused(device, err) from err

    @property
    def name(self) -> str:
        """Vendor, product and place."""
        return describe_device(self._device)

    def read_into(self, buffer: array.array[int], timeout_s: float) -> int:
        """Read one transfer from the camera into the front of the buffer; returns its bytes.

        The buffer holds whole packets; a transfer ends when it is full or by a short packet.
        """
        return self._twice(self._in, buffer, timeout_s, self._device.read)

    def write(self, data: bytes, timeout_s: float) -> None:
        """Send one transfer; one of whole packets is ended by an empty packet."""
        self._write_all(data, timeout_s)
        if len(data) % self.packet_b == 0:
            self._write_all(b"", timeout_s)

    def cancel(self, transaction_id: int) -> None:
        """Class request 64: give up a transaction."""
        data = b"\x01\x40" + transaction_id.to_bytes(4, "little")
        self._control(_CLASS_OUT, ClassRequest.CANCEL, data)

    def status(self) -> int:
        """Class request 67: the device's state as a response code; halted endpoints are cleared."""
        reply = bytes(self._control(_CLASS_IN, ClassRequest.GET_DEVICE_STATUS, _STATUS_B))
        if len(reply) < 4:
            raise TransactionMismatch(f"device status of {len(reply)} bytes")
        for at in range(4, len(reply) - 3, 4):
            self.clear_halt(int.from_bytes(reply[at : at + 4], "little"))
        return int.from_bytes(reply[2:4], "little")

    def device_reset(self) -> None:
        """Class request 66: the camera forgets its session and everything that belongs to it."""
        self._control(_CLASS_OUT, ClassRequest.DEVICE_RESET, b"")
        for endpoint in (self._in, self._out):
            self.clear_halt(endpoint)

    def clear_halt(self, endpoint: int) -> None:
        """Let an endpoint go on after a stall."""
        try:
            self._device.clear_halt(endpoint)
        except usb.core.USBError as err:
            raise to_wire_fault(err) from err

    def usb_reset(self) -> None:
        """Reset the port. The device comes back under a new address: find it again."""
        try:
            self._device.reset()
        except usb.core.USBError as err:
            if err.errno not in _WENT:  # libusb's error for a device that comes back as a new one
                raise to_wire_fault(err) from err
        finally:
            self.close()

    def close(self) -> None:
        """Release interface and device. Idempotent; a device that is gone is released as well."""
        try:
            usb.util.dispose_resources(self._device)
        except usb.core.USBError as err:
            if err.errno not in _WENT:
                raise to_wire_fault(err) from err

    def _write_all(self, data: bytes, timeout_s: float) -> None:
        sent = self._twice(self._out, data, timeout_s, self._device.write)
        if sent != len(data):
            raise TransactionMismatch(f"only {sent} of {len(data)} bytes were taken")

    def _twice(self, endpoint: int, data: Any, timeout_s: float, transfer: Any) -> int:
        left_ms = max(1, round(timeout_s * 1e3))
        stalled = False
        while True:
            self._look()
            step_ms = min(left_ms, _STEP_MS)
            try:
                return int(transfer(endpoint, data, step_ms))
            except usb.core.USBError as err:
                fault = to_wire_fault(err)
                left_ms -= step_ms  # a transfer that timed out has moved nothing: begin anew
                waits = isinstance(fault, WireTimeout) and left_ms > 0
                if not waits and (stalled or not isinstance(fault, EndpointStall)):
                    raise fault from err
            if not waits:
                self.clear_halt(endpoint)
                stalled, left_ms = True, max(1, round(timeout_s * 1e3))

    def _control(self, kind: int, request: int, data: Any) -> Any:
        self._look()
        try:
            return self._device.ctrl_transfer(
                kind, request, 0, self._interface, data, round(_CONTROL_S * 1e3)
            )
        except usb.core.USBError as err:
            raise to_wire_fault(err) from err


def _interface(device: Any) -> Any:
    """The first still-image interface, or None. Descriptors are cached: nothing is opened."""
    try:
        for configuration in device:
            for interface in configuration:
                kind = (
                    interface.bInterfaceClass,
                    interface.bInterfaceSubClass,
                    interface.bInterfaceProtocol,
                )
                if kind == _STILL_IMAGE:
                    return interface
    except usb.core.USBError:  # a device that cannot be described is not ours
        return None
    return None


def _refused(device: Any, err: usb.core.USBError) -> DeviceLost:
    """The error that says why the interface could not be claimed, and what to do."""
    if err.errno == errno.EBUSY:
        who = describe_holders(
            list_holders(build_node_path(device.bus, device.address)), os.getpid()
        )
        return DeviceLost(f"{describe_device(device)} is held by {who}", device=DEVICE, hint=HINT)
    if err.errno in (errno.EACCES, errno.EPERM):
        return DeviceLost(
            f"{describe_device(device)} may not be opened", device=DEVICE, hint=PERMISSION_HINT
        )
    fault: WireFault = to_wire_fault(err)
    return DeviceLost(f"{describe_device(device)}: {fault.message}", device=DEVICE, hint=fault.hint)
