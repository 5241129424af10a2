"""What can go wrong on the wire, as the recovery ladder tells it apart.

All are `DeviceLost`, so that one nobody dealt with still reaches the client as a typed error.
"""

from __future__ import annotations

import errno

import usb.core

from pdcd.driver import DeviceLost

DEVICE = "camera"
POWER_CYCLE = "switch the camera off and on, check its battery and cable, and try again"

_GONE = frozenset({errno.ENODEV, errno.ESHUTDOWN, errno.ENXIO})


class WireFault(DeviceLost):
    """A transaction failed on the wire; what the camera made of it is not known."""

    def __init__(self, message: str, *, hint: str = POWER_CYCLE) -> None:
        super().__init__(message, device=DEVICE, hint=hint)


class WireTimeout(WireFault):
    """The camera did not take or give anything within the time."""


class EndpointStall(WireFault):
    """An endpoint is halted and stays so after clearing it once."""


class TransactionMismatch(WireFault):
    """What came is not what the transaction wants: another's id, too few bytes, damaged."""


class SessionLost(WireFault):
    """The camera does not know the session any more; what was asked was not done."""

    def __init__(self) -> None:
        super().__init__("forgot the session")


class DeviceGone(WireFault):
    """The device is not on the bus any more."""

    def __init__(self) -> None:
        super().__init__("was unplugged or switched off", hint="check cable, battery and switch")


class NoAnswer(WireFault):
    """An operation that must not be repeated got no answer; the wire itself works again."""


def to_wire_fault(err: usb.core.USBError) -> WireFault:
    """A libusb error as one of the above."""
    if err.errno in _GONE:
        return DeviceGone()
    if isinstance(err, usb.core.USBTimeoutError) or err.errno == errno.ETIMEDOUT:
        return WireTimeout("does not answer")
    if err.errno == errno.EPIPE:
        return EndpointStall("refuses to go on (endpoint halted)")
    return TransactionMismatch(f"USB transfer failed: {err}")
