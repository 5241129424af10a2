"""One controller on the USB, a DLPC900 or a DLPC350: found, claimed, and asked.

It is a HID device, but nothing of HID matters: reports of 64 bytes go out to one endpoint and come
from the other. The kernel's usbhid holds it, and takes it back afterwards.
"""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import usb.core
import usb.util

from pdcd.driver import DeviceLost, DriverUnavailable, to_one_line

from .commands import (
    ANSWER,
    READ,
    REFUSED,
    REPLY_HEAD_B,
    REPORT_B,
    Command,
    make_refusal,
    pack_command,
)

_VENDOR = 0x0451
_PRODUCTS = {"DLPC900": 0xC900, "DLPC350": 0x6401}
_INTERFACE, _OUT, _IN = 0, 0x01, 0x81
_ANSWER_S = 1.0
"""Longest wait for one report, or for an answer."""
_STEP_MS = 100
"""Longest transfer between two checks whether it is still wanted."""
_FLUSH_MS = 2
_MOST_STALE = 64
_GONE = (errno.ENODEV, errno.ESHUTDOWN, errno.ENXIO, errno.ENOENT)
_DENIED = (errno.EACCES, errno.EPERM)
_PERMISSION_HINT = "install pdcd's udev rule, be in its group, and plug the device in again"


class _NoAnswer(DeviceLost):
    """The device neither takes nor sends anything within the time."""


class FoundDevice(NamedTuple):
    """A device on the USB. serial : None if it has none, or may not be asked for it."""

    device: Any
    serial: str | None
    port: str
    controller: str

    @property
    def name(self) -> str:
        """Its name in messages."""
        return f"{self.serial or 'no serial number'} on port {self.port}"


def list_devices(backend: object, *controllers: str) -> list[FoundDevice]:
    """Every device with one of these controllers; if none is given, every DLPC900.

    backend : of pyusb; None is the machine's libusb. Raises DriverUnavailable, DeviceLost.
    """
    try:
        return [
            FoundDevice(one, _read_serial(one), _read_port(one), name)
            for name in controllers or ("DLPC900",)
            for one in usb.core.find(
                find_all=True, backend=backend, idVendor=_VENDOR, idProduct=_PRODUCTS[name]
            )
        ]
    except usb.core.NoBackendError as err:
        raise DriverUnavailable(
            "libusb is not installed", device="display", hint="install libusb-1.0"
        ) from err
    except usb.core.USBError as err:
        raise DeviceLost(
            f"cannot look at the USB: {err}", device="display", hint="see dmesg"
        ) from err


def choose_device(
    found: list[FoundDevice], wanted: str, role: str, kind: str = "DLPC900"
) -> FoundDevice:
    """The device with this serial number, or on this port. kind : for messages. Raises
    DeviceLost."""
    fitting = [one for one in found if wanted in (one.serial, one.port)]
    if len(fitting) == 1:
        return fitting[0]
    there = ", ".join(one.name for one in found) or "none"
    if fitting:
        raise DeviceLost(
            f"several devices are {wanted!r}: {there}",
            device=role,
            hint=f"name the port: display.options.{role} = {fitting[0].port!r}",
        )
    unknown = any(one.serial is None for one in found)
    raise DeviceLost(
        f"no {kind} is {wanted!r}; found: {there}",
        device=role,
        hint=_PERMISSION_HINT if unknown else "switch it on, check its cable and the serial number",
    )


class DeviceLink:
    """A claimed device, and its answers.

    Commands of several threads do not mix. Raises DeviceLost, after which the link is `lost` and a
    new one is needed; and the errors of refusals (`drivers.dlpc900.commands.make_refusal`).

    look : called before each command and while waiting for an answer; an exception from it ends the
        wait. A command that has begun is sent to its end, as the device would take the next one for
        the rest of it.
    """

    def __init__(self, found: FoundDevice, role: str, look: Callable[[], None]) -> None:
        self.found, self.role = found, role
        self._device, self._look = found.device, look
        self._has_codes = found.controller == "DLPC900"
        self.lost = False
        self._lock = threading.Lock()
        self._sequence = 0
        try:
            with suppress(NotImplementedError):
                if self._device.is_kernel_driver_active(_INTERFACE):
                    self._device.detach_kernel_driver(_INTERFACE)
            usb.util.claim_interface(self._device, _INTERFACE)
        except usb.core.USBError as err:
            usb.util.dispose_resources(self._device)
            raise self._refused(err) from err
        self._flush()

    def ask(self, command: int, data: bytes = b"") -> bytes:
        """Read something: the data of the answer."""
        with self._lock:
            answer = self._transact(READ | ANSWER, command, data)
            if answer is None:
                raise self._explain(command)
            return answer

    def try_ask(self, command: int) -> bytes | None:
        """The same for commands that not every firmware knows: None if refused or ignored."""
        with self._lock:
            try:
                answer = self._transact(READ | ANSWER, command, b"")
            except _NoAnswer:
                self.lost = False
                return None
            if answer is None and self._has_codes:
                self._read_code()  # else it would be taken for the answer to a later command
            return answer

    def tell(self, command: int, data: bytes) -> None:
        """Write something, and wait until the device has accepted it."""
        with self._lock:
            if self._transact(ANSWER, command, data) is None:
                raise self._explain(command)

    def pour(self, command: Command, data: bytes) -> None:
        """Write data without asking for an answer."""
        with self._lock:
            self._transact(0, command, data)

    def check_errors(self, command: Command) -> None:
        """Raise the error that the device reports for unanswered commands; `command` is named."""
        with self._lock:
            code = self._read_code()
            if code:
                raise make_refusal(self.role, command, code, self._read_text())

    def close(self) -> None:
        """Release the device to the kernel's driver. Idempotent."""
        with suppress(usb.core.USBError, NotImplementedError):
            usb.util.release_interface(self._device, _INTERFACE)
            self._device.attach_kernel_driver(_INTERFACE)
        with suppress(usb.core.USBError):
            usb.util.dispose_resources(self._device)

    def _explain(self, command: int) -> Exception:
        """The error of a command that has just been refused."""
        if not self._has_codes:
            return make_refusal(self.role, command, None, "")
        return make_refusal(self.role, command, self._read_code(), self._read_text())

    def _read_code(self) -> int | None:
        answer = self._transact(READ | ANSWER, Command.ERROR_CODE, b"")
        return answer[0] if answer else None

    def _read_text(self) -> str:
        answer = self._transact(READ | ANSWER, Command.ERROR_TEXT, b"") or b""
        return to_one_line(answer.partition(b"\0")[0].decode("ascii", "replace"))

    def _transact(self, flags: int, command: int, data: bytes) -> bytes | None:
        """Send a command; returns the data of its answer if one is wanted, None if it was
        refused."""
        self._look()
        self._sequence = self._sequence % 255 + 1
        packet = pack_command(flags, self._sequence, command, data)
        for at in range(0, len(packet), REPORT_B):
            report = packet[at : at + REPORT_B].ljust(REPORT_B, b"\0")
            self._transfer(self._device.write, _OUT, report, lambda: None)
        if not flags & ANSWER:
            return b""
        for _ in range(_MOST_STALE):
            answer = bytes(self._transfer(self._device.read, _IN, REPORT_B, self._look))
            if len(answer) < REPLY_HEAD_B or answer[1] != self._sequence:
                continue  # the answer to an earlier command, no longer wanted
            length = int.from_bytes(answer[2:4], "little")
            if answer[0] & REFUSED or (flags & READ and not length):
                return None
            return answer[REPLY_HEAD_B : REPLY_HEAD_B + length]
        raise DeviceLost(
            f"sends other answers than that to {command:#06x}",
            device=self.role,
            hint="end other programs that use it, switch it off and on",
        )

    def _transfer(self, transfer: Any, endpoint: int, data: Any, look: Callable[[], None]) -> Any:
        left_ms = round(_ANSWER_S * 1e3)
        while True:
            look()
            try:
                return transfer(endpoint, data, min(left_ms, _STEP_MS))
            except usb.core.USBError as err:
                left_ms -= _STEP_MS  # a transfer that timed out has moved nothing: begin anew
                if not _is_timeout(err) or left_ms <= 0:
                    self.lost = True
                    raise self._refused(err) from err

    def _flush(self) -> None:
        """Drop waiting answers to earlier commands."""
        with suppress(usb.core.USBError):
            for _ in range(_MOST_STALE):
                self._device.read(_IN, REPORT_B, _FLUSH_MS)

    def _refused(self, err: usb.core.USBError) -> DeviceLost:
        """The error for a libusb error, with a hint."""
        kind: type[DeviceLost] = DeviceLost
        name, hint = self.found.name, "switch it off and on, and check its cable"
        if err.errno in _GONE:
            what, hint = "was unplugged or switched off", "check cable and power"
        elif err.errno == errno.EBUSY:
            what, hint = "is held by another program", "end it: TI's GUI, or a second daemon"
        elif err.errno in _DENIED:
            what, hint = "may not be opened", _PERMISSION_HINT
        elif _is_timeout(err):
            kind, what = _NoAnswer, "does not answer"
        else:
            what = f"cannot be reached: {err}"
        return kind(f"{name} {what}", device=self.role, hint=hint)


def _is_timeout(err: usb.core.USBError) -> bool:
    return isinstance(err, usb.core.USBTimeoutError) or err.errno == errno.ETIMEDOUT


def _read_serial(device: Any) -> str | None:
    """The serial number that a device states; reading it opens the device."""
    try:
        return to_one_line(device.serial_number) if device.serial_number else None
    except (usb.core.USBError, ValueError):  # raised by pyusb when rights are missing
        return None


def _read_port(device: Any) -> str:
    """The port it is plugged into, as Linux writes it; an address if ports are not known."""
    ports = getattr(device, "port_numbers", None)
    if ports:
        return f"{device.bus}-{'.'.join(map(str, ports))}"
    return f"{device.bus}:{device.address}"
