"""The smallest PTP client over pyusb: what tests of the virtual camera drive it with.

Written apart from `drivers.ptp`, with its own struct strings, so that one does not hide the
mistakes of the other.
"""

from __future__ import annotations

import array
import struct
from typing import Any

import usb.core
import usb.util

from drivers.virtual_camera import (
    BULB_BODY,
    CameraBody,
    CameraExposure,
    CameraModel,
    FaultScript,
    PlainFilm,
    ShutterFilm,
    VirtualUsb,
)
from drivers.virtual_camera.develop import Develop, develop_at_once
from pdcd.bench.clock import VirtualClock

BULB = (0xD102, 0x0C)
RAM = (0xD11C, 4)


def raw_of(exposure: CameraExposure) -> bytes:
    """A file that tells which exposure it is: 3000 bytes."""
    return (b"RAW%d-%d" % (exposure.open_ns, exposure.close_ns)).ljust(3000, b".")


def virtual_usb(
    script: FaultScript | None = None,
    model: CameraModel = BULB_BODY,
    film: ShutterFilm | None = None,
    develop: Develop = develop_at_once,
) -> VirtualUsb:
    """A backend with a camera on a virtual clock."""
    return VirtualUsb(CameraBody(VirtualClock(), film or PlainFilm(raw_of), model, script, develop))


class Client:
    """One claimed camera. Times out after 1 s of the camera's clock."""

    def __init__(self, backend: VirtualUsb) -> None:
        self.body = backend.body
        self.device: Any = usb.core.find(backend=backend, idVendor=0x04A9)
        usb.util.claim_interface(self.device, 0)
        self.transaction = -1
        self.buffer = array.array("B", bytes(1 << 21))

    def close(self) -> None:
        usb.util.dispose_resources(self.device)

    def read(self) -> bytes:
        count = self.device.read(0x81, self.buffer, 1000)
        return self.buffer[:count].tobytes()

    def send(self, code: int, *parameters: int, data: bytes | None = None) -> None:
        self.transaction += 1
        size = 12 + 4 * len(parameters)
        head = struct.pack("<IHHI", size, 1, code, self.transaction)
        self.device.write(2, head + struct.pack(f"<{len(parameters)}I", *parameters), 1000)
        if data is not None:
            head = struct.pack("<IHHI", 12 + len(data), 2, code, self.transaction)
            self.device.write(2, head + data, 1000)

    def answer(self) -> tuple[int, tuple[int, ...], bytes]:
        """Response code, parameters, data of what was sent last."""
        data = b""
        block = self.read()
        length, kind, _, transaction = struct.unpack_from("<IHHI", block)
        if kind == 2:
            while len(block) < length:
                piece = self.read()
                if not piece:
                    break
                block += piece
            data = block[12:]
            block = self.read() or self.read()  # an empty packet may end the data
            length, kind, _, transaction = struct.unpack_from("<IHHI", block)
        assert (kind, transaction, length) == (3, self.transaction, len(block))
        (code,) = struct.unpack_from("<H", block, 6)
        return code, struct.unpack_from(f"<{(length - 12) // 4}I", block, 12), data

    def call(
        self, code: int, *parameters: int, data: bytes | None = None
    ) -> tuple[int, tuple[int, ...], bytes]:
        self.send(code, *parameters, data=data)
        return self.answer()

    def ok(self, code: int, *parameters: int, data: bytes | None = None) -> bytes:
        response, _, received = self.call(code, *parameters, data=data)
        assert response == 0x2001, f"{code:04x} -> {response:04x}"
        return received

    def set(self, prop: int, value: int) -> int:
        return self.call(0x9110, data=struct.pack("<III", 12, prop, value))[0]

    def events(self) -> list[bytes]:
        """The records of one GetEvent, without the one that ends them."""
        data = self.ok(0x9116)
        found = []
        while data:
            size, code = struct.unpack_from("<II", data)
            if code:
                found.append(data[:size])
            data = data[size:]
        return found

    def start(self) -> list[bytes]:
        """Open a session in remote and event mode; returns the first records."""
        self.ok(0x1002, 1)
        self.ok(0x9114, 1)
        self.ok(0x9115, 1)
        return self.events()

    def ready(self) -> None:
        """Everything up to the release: bulb, files to memory, room there, nothing unheard."""
        self.start()
        assert self.set(*RAM) == 0x2001
        self.ok(0x911A, 0x0FFFFFFF, 0x1000, 1)
        if 0x0C in self.body.settings.lists[0xD102]:
            assert self.set(*BULB) == 0x2001
        while self.events():
            pass

    def wait(self, seconds: float) -> None:
        clock = self.body.clock
        clock.sleep_until_ns(clock.now_ns() + round(seconds * 1e9))

    def files(self) -> list[tuple[int, int, str]]:
        """Handle, size and name of the files that the next events announce."""
        found = []
        for record in self.events():
            (code,) = struct.unpack_from("<I", record, 4)
            if code == 0xC186:
                handle, size = struct.unpack_from("<I8xI", record, 8)
                found.append((handle, size, record[0x1C:].rstrip(b"\0").decode()))
            elif code == 0xC181:
                handle, size = struct.unpack_from("<I16xI", record, 8)
                found.append((handle, size, record[0x28:].rstrip(b"\0").decode()))
        return found
