"""The virtual camera on the USB: a pyusb backend that real pyusb code drives unchanged.

Give it to ``usb.core.find(backend=...)``. Errors are those that libusb raises, with its codes and
errno. Bulk reads end as on a real USB: when the buffer is full, or at a short packet, which is
empty if the transfer is a whole number of packets. Bytes are copied once, from the file to the
caller's buffer.

Not modelled: the speed of the USB, packets on their own, isochronous transfers, hubs, power.
"""

from __future__ import annotations

import array
import struct
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

from ..ptp.codes import ClassRequest, ContainerType, ResponseCode
from ..ptp.containers import (
    HEADER_BYTES,
    WireError,
    pack_data_header,
    pack_message,
    parse_header,
    parse_message,
)
from ..virtual_usb import (
    STRING_DESCRIPTOR,
    LibusbCode,
    OneInterfaceUsb,
    copy_reply,
    make_device_descriptor,
    make_string_descriptor,
    make_usb_error,
)
from .body import DATA_OUT, CameraBody
from .model import USB_ID
from .reply import CameraReply

_BULK_IN, _BULK_OUT, _INTERRUPT_IN = 0x81, 0x02, 0x83
_PACKET_BYTES = 512
_FIRST_ADDRESS = 7
_BULK, _INTERRUPT, _HIGH_SPEED = 2, 3, 3


class _Transfer:
    """One bulk transfer to the computer, taken piece by piece."""

    def __init__(self, *parts: bytes | memoryview) -> None:
        self._parts = deque(memoryview(part).cast("B") for part in parts if len(part))
        self.left = sum(map(len, self._parts))
        self.ends_empty = self.left % _PACKET_BYTES == 0

    def read_into(self, buffer: memoryview) -> int:
        """Fill the buffer as far as it goes."""
        filled = 0
        while self._parts and filled < len(buffer):
            part = self._parts[0]
            count = min(len(part), len(buffer) - filled)
            buffer[filled : filled + count] = part[:count]
            filled += count
            if count == len(part):
                self._parts.popleft()
            else:
                self._parts[0] = part[count:]
        self.left -= filled
        return filled


class _Handle:
    """An opened device; useless once the device has come back under another address."""

    def __init__(self, address: int) -> None:
        self.address = address


class VirtualUsb(OneInterfaceUsb):
    """A USB with one camera on it. Its methods are those that pyusb documents of a backend.

    With `held_by_other` set, another program holds the interface: claims fail with EBUSY.
    """

    interface_class = (6, 1, 1)  # still images
    endpoints = (
        (_BULK_IN, _BULK, _PACKET_BYTES, 0),
        (_BULK_OUT, _BULK, _PACKET_BYTES, 0),
        (_INTERRUPT_IN, _INTERRUPT, 8, 9),
    )

    def __init__(self, body: CameraBody) -> None:
        super().__init__()
        self.body = body
        self.held_by_other = False
        self._lock = threading.RLock()
        self._resets = 0
        self._claimed_by: _Handle | None = None
        self._halted: set[int] = set()
        self._to_host: deque[_Transfer] = deque()
        self._command: tuple[int, int, tuple[int, ...]] | None = None
        self._data = bytearray()
        self._expected: int | None = None

    @property
    def address(self) -> int:
        """The camera's address on its bus; it changes each time the camera comes back."""
        return _FIRST_ADDRESS + self._resets + self.body.plugged_again

    # What the device says of itself

    def enumerate_devices(self) -> Iterator[Any]:
        """The camera, while it is plugged in."""
        return iter([SimpleNamespace(address=self.address)] if self.body.plugged else [])

    def get_device_descriptor(self, dev: Any) -> Any:
        """USB 2.0, high speed, the 450D's numbers."""
        place = dev.address, (1,)
        return make_device_descriptor(
            USB_ID, place, usb_version=0x0200, version=0x0002, speed=_HIGH_SPEED
        )

    # Opening and claiming

    def open_device(self, dev: Any) -> _Handle:
        """Open; ENODEV when the camera is not plugged in, or has another address by now."""
        handle = _Handle(dev.address)
        self._alive(handle)
        return handle

    def close_device(self, dev_handle: _Handle) -> None:
        """Close, and release what was claimed."""
        if self._claimed_by is dev_handle:
            self._claimed_by = None

    def set_configuration(self, dev_handle: _Handle, _config_value: int) -> None:
        """Nothing changes."""
        self._alive(dev_handle)

    def claim_interface(self, dev_handle: _Handle, _intf: int) -> None:
        """Claim; EBUSY when somebody else has it."""
        self._alive(dev_handle)
        holder = self._claimed_by
        if holder is not None and holder.address != self.address:
            holder = None  # the claim ended with the device that it was on
            self._forget()
        if self.held_by_other or holder not in (None, dev_handle):
            raise make_usb_error(LibusbCode.BUSY)
        self._claimed_by = dev_handle

    def release_interface(self, dev_handle: _Handle, _intf: int) -> None:
        """Release; ENOENT when it was not claimed."""
        self._alive(dev_handle)
        if self._claimed_by is not dev_handle:
            raise make_usb_error(LibusbCode.NOT_FOUND)
        self._claimed_by = None

    def is_kernel_driver_active(self, _dev_handle: _Handle, _intf: int) -> bool:
        """Never: Linux has no driver for still cameras."""
        return False

    def detach_kernel_driver(self, _dev_handle: _Handle, _intf: int) -> None:
        """ENOENT: there is none."""
        raise make_usb_error(LibusbCode.NOT_FOUND)

    def attach_kernel_driver(self, _dev_handle: _Handle, _intf: int) -> None:
        """ENOENT: there is none."""
        raise make_usb_error(LibusbCode.NOT_FOUND)

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        """Let the endpoint go on."""
        self._alive(dev_handle)
        self._halted.discard(ep)

    def reset_device(self, dev_handle: _Handle) -> None:
        """Reset the port: the camera comes back under the next address, without a session."""
        self._alive(dev_handle)
        with self._lock:
            self._forget()
            self.body.forget_session()
            self._resets += 1

    # Transfers

    def bulk_write(
        self, dev_handle: _Handle, ep: int, _intf: int, data: array.array[int], timeout: int
    ) -> int:
        """Take bytes from the computer; a complete container is answered at once."""
        with self._transfer(dev_handle, ep):
            view = memoryview(data).cast("B")
            try:
                self._take(view)
            except WireError:  # a camera that is sent nonsense halts
                self._forget()
                self._halted.add(ep)
                raise make_usb_error(LibusbCode.PIPE) from None
            return len(view)

    def bulk_read(
        self, dev_handle: _Handle, ep: int, _intf: int, buff: array.array[int], timeout: int
    ) -> int:
        """Give bytes to the computer; if there are none, a time-out after `timeout` ms."""
        with self._transfer(dev_handle, ep):
            if not self._to_host:
                self._wait(timeout)
                raise make_usb_error(LibusbCode.TIMEOUT)
            transfer = self._to_host[0]
            buffer = memoryview(buff).cast("B")
            if transfer.left > len(buffer) and len(buffer) % _PACKET_BYTES:
                self._to_host.popleft()
                raise make_usb_error(LibusbCode.OVERFLOW)  # a packet that does not fit is lost
            count = transfer.read_into(buffer)
            if not transfer.left and not (transfer.ends_empty and count == len(buffer)):
                self._to_host.popleft()
            return count

    def intr_read(
        self, dev_handle: _Handle, ep: int, _intf: int, buff: array.array[int], timeout: int
    ) -> int:
        """Time out: EOS bodies send nothing here that `GetEvent` does not report."""
        with self._transfer(dev_handle, ep):
            self._wait(timeout)
            raise make_usb_error(LibusbCode.TIMEOUT)

    def ctrl_transfer(
        self,
        dev_handle: _Handle,
        bmRequestType: int,  # noqa: N803 - pyusb's names
        bRequest: int,  # noqa: N803
        wValue: int,  # noqa: N803
        wIndex: int,  # noqa: N803
        data: array.array[int],
        timeout: int,
    ) -> int:
        """The class requests, and string descriptors."""
        self._alive(dev_handle)
        with self._lock:
            reply = self._control(bmRequestType, bRequest, wValue, bytes(data))
        if bmRequestType & 0x80:
            return copy_reply(reply, data)
        return len(data)

    def _control(self, kind: int, request: int, value: int, data: bytes) -> bytes:
        match kind, request:
            case (0x21, ClassRequest.CANCEL) if len(data) == 6:
                self._forget(halted=False)
                return b""
            case (0x21, ClassRequest.DEVICE_RESET):
                self._forget()
                self.body.forget_session()
                return b""
            case (0xA1, ClassRequest.GET_DEVICE_STATUS):
                halted = sorted(self._halted)
                code = ResponseCode.TRANSACTION_CANCELLED if halted else ResponseCode.OK
                length = 4 + 4 * len(halted)
                return struct.pack(f"<HH{len(halted)}I", length, code, *halted)
            case (0x80, 6) if value >> 8 == STRING_DESCRIPTOR:
                return self._string(value & 0xFF)
        raise make_usb_error(LibusbCode.PIPE)

    def _string(self, index: int) -> bytes:
        info = self.body.model.info
        return make_string_descriptor(index, (info.manufacturer, info.model, info.serial))

    # Containers

    def _take(self, view: memoryview) -> None:
        """Take a command, or a piece of its data, and answer when all is there."""
        if self._command is None:
            if not len(view):
                return  # the empty packet behind a container of whole packets
            message, taken = parse_message(view)
            if message.kind is not ContainerType.COMMAND or taken != len(view):
                raise WireError("not a command alone")
            self._to_host.clear()  # a new command: whoever sends it has given up the last answer
            if message.code in DATA_OUT:
                self._command = message.code, message.transaction, message.parameters
                self._data.clear()
                self._expected = None
            else:
                self._do(message.code, message.transaction, message.parameters, b"")
            return
        self._data += view
        if self._expected is None:
            header = parse_header(self._data)
            if header.kind is not ContainerType.DATA or header.length_bytes is None:
                raise WireError("no data where data were due")
            self._expected = header.length_bytes
        if len(self._data) >= self._expected:
            code, transaction, parameters = self._command
            data = bytes(self._data[HEADER_BYTES : self._expected])
            self._command = None
            self._do(code, transaction, parameters, data)

    def _do(self, code: int, transaction: int, parameters: tuple[int, ...], data: bytes) -> None:
        reply = self.body.transact(code, parameters, data)
        if reply.fault == "unplug":
            self._forget()
            raise make_usb_error(LibusbCode.NO_DEVICE)
        if reply.fault in ("mute", "deaf"):
            return
        if reply.fault == "stall":
            self._halted.add(_BULK_IN)
        self._to_host.extend(_transfers(code, transaction, reply))

    def _forget(self, *, halted: bool = True) -> None:
        self._to_host.clear()
        self._command = None
        if halted:
            self._halted.clear()

    # Checks

    @contextmanager
    def _transfer(self, handle: _Handle, ep: int) -> Iterator[None]:
        """Allow one transfer at a time, on a device that is there, claimed and not halted."""
        self._alive(handle)
        if self._claimed_by is not handle:
            raise make_usb_error(LibusbCode.IO)
        with self._lock:
            if ep in self._halted:
                raise make_usb_error(LibusbCode.PIPE)
            yield

    def _alive(self, handle: _Handle) -> None:
        if not self.body.plugged or handle.address != self.address:
            raise make_usb_error(LibusbCode.NO_DEVICE)

    def _wait(self, timeout_ms: int) -> None:
        clock = self.body.clock
        clock.sleep_until_ns(clock.now_ns() + timeout_ms * 1_000_000)


def _transfers(code: int, transaction: int, reply: CameraReply) -> list[_Transfer]:
    """Data and response of one answer, each a transfer of its own."""
    found = []
    if reply.data is not None:
        data = memoryview(reply.data)
        header = pack_data_header(code, transaction, len(data))
        if reply.fault == "short-read":
            data = data[: len(data) // 2]
        found.append(_Transfer(header, data))
    stated = transaction + 1 if reply.fault == "wrong-transaction" else transaction
    message = pack_message(
        ContainerType.RESPONSE, reply.code, stated & 0xFFFFFFFF, reply.parameters
    )
    return [*found, _Transfer(message)]
