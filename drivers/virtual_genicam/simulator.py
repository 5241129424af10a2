"""Aravis' simulator of a GigE Vision camera, hosted in this process: its memory and its frames.

It speaks the protocol on 127.0.0.1 from a thread of the library, and that thread asks for the bytes
of each frame. Only one can run at a time: the protocol prescribes the port.
"""

from __future__ import annotations

import ctypes
import socket
import tempfile
from collections.abc import Callable
from ctypes import CFUNCTYPE, byref, c_char_p, c_double, c_int, c_size_t, c_uint32, c_void_p
from pathlib import Path

from pdcd.driver import DeviceLost

from ..genicam.library import AravisLibrary, load_library
from .description import Register

VIRTUAL_ADDRESS = "127.0.0.1"
_FILL = CFUNCTYPE(None, c_void_p, c_void_p, c_uint32, c_uint32, c_uint32)
_PORT = 3956
_XML_AT, _XML_URL, _XML_URL_BYTES = 0x10000, 0x200, 512
"""Addresses of the description and of the URL that points to it; the URL's room in bytes."""
_LOOKS_HZ = 1e6 / 2080.0
"""How often the simulator checks whether it is to send a frame. It waits in whole milliseconds, and
spins for the rest of the period: so little here that the wait, which ends late, covers it."""


class HostedSimulator:
    """One simulated camera that can be reached, until it is closed.

    payload : called on the library's thread; returns the bytes of the frame that is due.
    """

    def __init__(self, xml: bytes, serial: str, payload: Callable[[], bytes]) -> None:
        """Raises DeviceLost if the address is taken."""
        _check_free()
        self._lib: AravisLibrary = load_library()
        self._declare()
        self._payload = payload
        # The library keeps the file mapped, so that the name may go at once.
        with tempfile.NamedTemporaryFile(suffix=".xml") as file:
            Path(file.name).write_bytes(xml)
            self._camera: int | None = self._lib.arv.arv_gv_fake_camera_new_full(
                VIRTUAL_ADDRESS.encode(), serial.encode(), file.name.encode()
            )
            running = self._lib.arv.arv_gv_fake_camera_is_running(self._camera)
        if not running:
            self.close()
            raise _cannot_listen()
        self._memory = self._lib.arv.arv_gv_fake_camera_get_fake_camera(self._camera)
        # Some clients take a number without a prefix for a decimal one.
        where = f"Local:virtual.xml;{_XML_AT:#x};{len(xml):#x}"
        self.write_text(_XML_URL, where, _XML_URL_BYTES)
        self._on_fill = _FILL(self._fill)
        self._lib.arv.arv_fake_camera_set_fill_pattern(self._memory, self._on_fill, None)
        self._lib.arv.arv_fake_camera_set_trigger_frequency(self._memory, _LOOKS_HZ)

    def read(self, address: int) -> int:
        """A word of its memory; 0 once it is closed."""
        return 0 if self._camera is None else self._read(address)

    def write(self, address: int, value: int) -> None:
        """Write a word."""
        if self._camera is not None:
            self._lib.arv.arv_fake_camera_write_register(self._memory, address, value)

    def write_text(self, address: int, text: str, length: int) -> None:
        """Write a string of at most `length` bytes, padded with zeros."""
        data = text.encode()[: length - 1].ljust(length, b"\0")
        self._lib.arv.arv_fake_camera_write_memory(self._memory, address, length, data)

    def lose_packets(self, share: float) -> None:
        """Lose that share of the frames' packets from now on."""
        self._lib.gobject.g_object_set(
            c_void_p(self._camera), b"gvsp-lost-ratio", c_double(share), None
        )

    def close(self) -> None:
        """Fall silent, as if the cable were pulled. Idempotent."""
        camera, self._camera = self._camera, None
        if camera is not None:
            self._lib.gobject.g_object_unref(camera)

    def _fill(self, buffer: int, data: int, exposure_us: int, gain: int, code: int) -> None:
        place = self._lib.arv.arv_buffer_get_data(buffer, byref(c_size_t()))
        # The size reported is that of received data. The buffer has the size set in the registers.
        room = self._read_payload_bytes()
        ctypes.memmove(place, self._payload()[:room].ljust(room, b"\0"), room)

    def _read_payload_bytes(self) -> int:
        # Also called during closing: a frame that is sent then must not be an old one.
        pixels = self._read(Register.WIDTH) * self._read(Register.HEIGHT)
        return pixels * (self._read(Register.PIXEL_FORMAT) >> 16 & 0xFF) // 8

    def _read(self, address: int) -> int:
        value = c_uint32()
        self._lib.arv.arv_fake_camera_read_register(self._memory, address, byref(value))
        return value.value

    def _declare(self) -> None:
        arv, pointer = self._lib.arv, c_void_p
        for name, returned, taken in (
            ("arv_gv_fake_camera_new_full", pointer, (c_char_p, c_char_p, c_char_p)),
            ("arv_gv_fake_camera_is_running", c_int, (pointer,)),
            ("arv_gv_fake_camera_get_fake_camera", pointer, (pointer,)),
            ("arv_fake_camera_set_fill_pattern", None, (pointer, _FILL, pointer)),
            ("arv_fake_camera_set_trigger_frequency", None, (pointer, c_double)),
            ("arv_fake_camera_read_register", c_int, (pointer, c_uint32, pointer)),
            ("arv_fake_camera_write_register", c_int, (pointer, c_uint32, c_uint32)),
            ("arv_fake_camera_write_memory", c_int, (pointer, c_uint32, c_uint32, c_char_p)),
        ):
            function = getattr(arv, name)
            function.restype, function.argtypes = returned, taken


def _check_free() -> None:
    """Raise DeviceLost if somebody else listens: the simulator itself would not report that."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((VIRTUAL_ADDRESS, _PORT))
        except OSError as err:
            raise _cannot_listen() from err


def _cannot_listen() -> DeviceLost:
    return DeviceLost(
        f"the virtual camera cannot listen at {VIRTUAL_ADDRESS}",
        device="camera",
        hint="end the daemon or program that has another virtual camera here",
    )
