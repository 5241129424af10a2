"""Faults on the wire, as the recovery ladder distinguishes them.

All are `DeviceLost`, so that an unhandled fault still reaches the client as a typed error.
"""

from __future__ import annotations

import errno

import usb.core

from pdcd.driver import DeviceLost

DEVICE = "camera"
POWER_CYCLE = "switch the camera off and on, check its battery and cable, and try again"

_GONE = frozenset({errno.ENODEV, errno.ESHUTDOWN, errno.ENXIO})


class WireFault(DeviceLost):
    """A transaction failed on the wire; whether the camera carried it out is not known."""

    def __init__(self, message: str, *, hint: str = POWER_CYCLE) -> None:
        super().__init__(message, device=DEVICE, hint=hint)


class WireTimeout(WireFault):
    """The camera neither took nor sent anything within the time."""


class EndpointStall(WireFault):
    """An endpoint is halted and stays so after clearing it once."""


class TransactionMismatch(WireFault):
    """The answer does not fit the transaction: a wrong id, too few bytes, or damaged."""


class SessionLost(WireFault):
    """The camera does not know the session any more; the operation was not done."""

    def __init__(self) -> None:
        super().__init__("forgot the session")


class DeviceGone(WireFault):
    """The device is not on the bus any more."""

    def __init__(self) -> None:
        super().__init__("was unplugged or switched off", hint="check cable, battery and switch")


class NoAnswer(WireFault):
    """An operation that must not be repeated got no answer; the connection works again."""


def to_wire_fault(err: usb.core.USBError) -> WireFault:
    """A libusb error as one of the above."""
    if err.errno in _GONE:
        return DeviceGone()
    if isinstance(err, usb.core.USBTimeoutError) or err.errno == errno.ETIMEDOUT:
        return WireTimeout("does not answer")
    if err.errno == errno.EPIPE:
        return EndpointStall("refuses to go on (endpoint halted)")
    return TransactionMismatch(f"USB transfer failed: {err}")
