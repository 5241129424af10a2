"""What backends of virtual USB devices have in common: errors as libusb raises them, and
descriptors."""

from __future__ import annotations

import errno
import struct
from enum import IntEnum

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


def require_first(*indices: int) -> None:
    """Raise IndexError unless all are 0: there is one of each, and pyusb counts up until then."""
    if any(indices):
        raise IndexError(indices)
