"""A camera through Aravis: found, opened, its features by name, its frames.

It is thin: each method is one or two calls of the library, whose errors become `AravisError`.
`drivers.genicam.device` knows how cameras differ, and what a photo needs.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator
from ctypes import POINTER, byref, c_double, c_int64, c_size_t, c_uint, c_uint32
from dataclasses import dataclass
from typing import Any

from .library import AravisLibrary, GError, load_library

WRONG_FEATURE, NOT_FOUND = 0, 6
"""Codes of the domain `DEVICE_DOMAIN`."""
_LOST = (2, 4, 5, NOT_FOUND, 10)
"""Codes for: not connected, transfer failed, timeout, not found, no longer its controller."""
DEVICE_DOMAIN = "arv-device-error-quark"

STATUS_WORDS = {
    -1: "unknown",
    0: "success",
    1: "cleared",
    2: "timeout",
    3: "missing packets",
    4: "wrong packet id",
    5: "size mismatch",
    6: "filling",
    7: "aborted",
    8: "payload not supported",
}
"""`ArvBufferStatus` in words."""

_PACKET_SOCKET_DISABLED = 1
_CHECK = 1  # ArvAccessCheckPolicy and ArvRangeCheckPolicy: enabled
_SOCKET_BUFFER_FIXED, _RESEND_NEVER, _RESEND_ALWAYS = 0, 0, 1
_SOCKET_BYTES = 8 * 2**20
_PRIVILEGE, _CONTROLLED = 0xA00, 0b11
"""Register of GigE Vision that says whether the camera is controlled, and the bits that say so."""


class AravisError(Exception):
    """An error of the library. `domain` and `code` are GLib's."""

    def __init__(self, message: str, domain: str = "", code: int = 0) -> None:
        super().__init__(message)
        self.domain = domain
        self.code = code

    @property
    def lost(self) -> bool:
        """Whether the camera did not answer, rather than refuse."""
        return self.domain == DEVICE_DOMAIN and self.code in _LOST

    @property
    def other_kind(self) -> bool:
        """Whether the feature exists, but is not a number of that kind."""
        return self.domain == DEVICE_DOMAIN and self.code == WRONG_FEATURE


@dataclass(frozen=True)
class FoundCamera:
    """One camera on the networks or the USB, as it announces itself."""

    id: str
    vendor: str
    model: str
    serial: str
    address: str
    protocol: str


@dataclass(frozen=True)
class RawBuffer:
    """One frame as it came. `status` 0 is a whole frame; `timestamp_ns` is on the camera's clock;
    with `chunks`, `data` holds more than the picture."""

    status: int
    frame_id: int
    timestamp_ns: int
    width: int
    height: int
    pixel_format: int
    data: bytes
    chunks: bool = False


def list_cameras() -> list[FoundCamera]:
    """All cameras that answer; Aravis waits a second for answers."""
    arv = load_library().arv
    arv.arv_update_device_list()

    def text(name: str, number: int) -> str:
        found = getattr(arv, f"arv_get_device_{name}")(number)
        return found.decode(errors="replace") if found else ""

    names = ("id", "vendor", "model", "serial_nbr", "address", "protocol")
    return [
        FoundCamera(*(text(name, number) for name in names))
        for number in range(arv.arv_get_n_devices())
    ]


class AravisCamera:
    """One open camera. After `close`, no method but `close` may be called.

    Signals of the library are not used: they arrive on a thread of the library, and releasing the
    camera meanwhile would end this process (GLib: "Resource deadlock avoided").
    """

    def __init__(self, identifier: str) -> None:
        """Open by an identifier of `FoundCamera`, or the address of a GigE camera.

        Raises AravisError."""
        library: AravisLibrary = load_library()
        self._lib = library
        self._arv = library.arv
        self._stream: int | None = None
        self._camera: int | None = self._checked("arv_camera_new", identifier)
        if self._camera is None:
            raise AravisError(f"no camera {identifier}", DEVICE_DOMAIN, NOT_FOUND)
        self._device = self._arv.arv_camera_get_device(self._camera)
        self._arv.arv_camera_set_access_check_policy(self._camera, _CHECK)
        self._arv.arv_camera_set_range_check_policy(self._camera, _CHECK)

    @property
    def on_network(self) -> bool:
        """Whether it speaks GigE Vision."""
        return bool(self._arv.arv_camera_is_gv_device(self._camera))

    @property
    def ours(self) -> bool:
        """Whether it is still controlled from here. A camera on a network may be open without
        being controlled; its heartbeat, once a second, notices when control is lost."""
        return not self.on_network or bool(self._arv.arv_gv_device_is_controller(self._device))

    def ask_ours(self) -> bool:
        """The same, but the camera itself is asked: a restarted camera no longer knows its
        controller, before a heartbeat notices."""
        if not self.on_network:
            return True
        found = c_uint32()
        self._checked("arv_device_read_register", _PRIVILEGE, byref(found))
        return self.ours and bool(found.value & _CONTROLLED)

    def has(self, feature: str) -> bool:
        """Whether the feature exists and is available now."""
        return bool(self._checked("arv_device_is_feature_available", feature))

    def get_text(self, feature: str) -> str:
        """Value of a string or an enumeration."""
        found = self._checked("arv_device_get_string_feature_value", feature)
        return found.decode(errors="replace") if found else ""

    def set_text(self, feature: str, value: str) -> None:
        """Set a string or an enumeration."""
        self._checked("arv_device_set_string_feature_value", feature, value.encode())

    def get_integer(self, feature: str) -> int:
        """Value of an integer."""
        return int(self._checked("arv_device_get_integer_feature_value", feature))

    def set_integer(self, feature: str, value: int) -> None:
        """Set an integer."""
        self._checked("arv_device_set_integer_feature_value", feature, value)

    def get_number(self, feature: str) -> float:
        """Value of a float, or of a whole number, as in older cameras."""
        try:
            return float(self._checked("arv_device_get_float_feature_value", feature))
        except AravisError as err:
            if not err.other_kind:
                raise
            return float(self.get_integer(feature))

    def set_number(self, feature: str, value: float) -> None:
        """Set a float, or the nearest whole number."""
        try:
            self._checked("arv_device_set_float_feature_value", feature, value)
        except AravisError as err:
            if not err.other_kind:
                raise
            self.set_integer(feature, round(value))

    def set_boolean(self, feature: str, value: bool) -> None:
        """Set a boolean."""
        self._checked("arv_device_set_boolean_feature_value", feature, int(value))

    def get_boolean(self, feature: str) -> bool:
        """Value of a boolean."""
        return bool(self._checked("arv_device_get_boolean_feature_value", feature))

    def bounds(self, feature: str) -> tuple[float, float]:
        """Least and largest value of a float, or of a whole number."""
        low, high = c_double(), c_double()
        try:
            self._checked("arv_device_get_float_feature_bounds", feature, byref(low), byref(high))
        except AravisError as err:
            if not err.other_kind:
                raise
            return self.integer_bounds(feature)
        return low.value, high.value

    def unit(self, feature: str) -> str | None:
        """Unit of a float, "" if it has none; None for a feature that is not a float."""
        try:
            self._checked("arv_device_get_float_feature_value", feature)
        except AravisError as err:
            if not err.other_kind:
                raise
            return None
        node = self._arv.arv_device_get_feature(self._device, feature.encode())
        found = self._arv.arv_gc_float_get_unit(node)
        return found.decode(errors="replace") if found else ""

    def integer_bounds(self, feature: str) -> tuple[int, int]:
        """Least and largest value of an integer."""
        low, high = c_int64(), c_int64()
        self._checked("arv_device_get_integer_feature_bounds", feature, byref(low), byref(high))
        return low.value, high.value

    def choices(self, feature: str) -> tuple[str, ...]:
        """Values that an enumeration may have now."""
        count = c_uint()
        found = self._checked(
            "arv_device_dup_available_enumeration_feature_values_as_strings", feature, byref(count)
        )
        try:
            return tuple(found[number].decode(errors="replace") for number in range(count.value))
        finally:
            self._lib.glib.g_free(found)

    def choose(self, feature: str, value: str) -> None:
        """Set an enumeration, if it has another value and offers this one."""
        if self.get_text(feature) != value and value in self.choices(feature):
            self.set_text(feature, value)

    def execute(self, command: str) -> None:
        """Give a command."""
        self._checked("arv_device_execute_command", command)

    def start(self) -> None:
        """Start the acquisition: from now on frames come as triggers allow."""
        self._checked("arv_camera_start_acquisition", device=False)

    def stop(self) -> None:
        """Stop it; a running exposure is abandoned."""
        self._checked("arv_camera_stop_acquisition", device=False)

    def set_packet_size(self, size: int | None) -> int:
        """Set the packet size of a GigE camera, in bytes; None: as large as the network allows, as
        found by test packets. Returns the size that is set."""
        if size is not None:
            self._checked("arv_camera_gv_set_packet_size", size, device=False)
        elif self.has("GevSCPSFireTestPacket"):
            return int(self._checked("arv_camera_gv_auto_packet_size", device=False))
        return int(self._checked("arv_camera_gv_get_packet_size", device=False))

    def open_stream(self, payload_bytes: int, buffers: int, *, resend: bool) -> None:
        """Prepare to receive frames of that size.

        Socket buffers are large. No packet socket is used: with one, root receives no frames on the
        loopback, and other users may not open one.
        """
        if self.on_network:
            self._arv.arv_camera_gv_set_stream_options(self._camera, _PACKET_SOCKET_DISABLED)
        stream = self._checked("arv_camera_create_stream", None, None, device=False)
        self._stream = stream
        if self.on_network:
            self._set(stream, "socket-buffer", _SOCKET_BUFFER_FIXED)
            self._set(stream, "socket-buffer-size", _SOCKET_BYTES)
            self._set(stream, "packet-resend", _RESEND_ALWAYS if resend else _RESEND_NEVER)
        for _ in range(buffers):
            self._arv.arv_stream_push_buffer(
                stream, self._arv.arv_buffer_new_allocate(payload_bytes)
            )

    def pop(self, wait_s: float) -> RawBuffer | None:
        """The next frame, whole or not; None if none came in that time."""
        if self._stream is None:
            return None
        if wait_s > 0.0:
            buffer = self._arv.arv_stream_timeout_pop_buffer(self._stream, round(wait_s * 1e6))
        else:
            buffer = self._arv.arv_stream_try_pop_buffer(self._stream)
        if not buffer:
            return None
        try:
            return self._read(buffer)
        finally:
            self._arv.arv_stream_push_buffer(self._stream, buffer)

    def close_stream(self) -> None:
        """Stop receiving. Idempotent."""
        stream, self._stream = self._stream, None
        if stream is not None:
            self._lib.gobject.g_object_unref(stream)

    def close(self) -> None:
        """Release the camera. Idempotent; takes seconds if it does not answer."""
        self.close_stream()
        camera, self._camera = self._camera, None
        if camera is not None:
            self._lib.gobject.g_object_unref(camera)

    def _read(self, buffer: int) -> RawBuffer:
        arv, size = self._arv, c_size_t()
        status = arv.arv_buffer_get_status(buffer)
        whole = status == 0
        place = arv.arv_buffer_get_data(buffer, byref(size)) if whole else None
        return RawBuffer(
            status=status,
            frame_id=arv.arv_buffer_get_frame_id(buffer),
            timestamp_ns=arv.arv_buffer_get_timestamp(buffer),
            width=arv.arv_buffer_get_image_width(buffer) if whole else 0,
            height=arv.arv_buffer_get_image_height(buffer) if whole else 0,
            pixel_format=arv.arv_buffer_get_image_pixel_format(buffer) if whole else 0,
            data=ctypes.string_at(place, size.value) if place else b"",
            chunks=whole and bool(arv.arv_buffer_has_chunks(buffer)),
        )

    def _set(self, instance: int, name: str, value: int) -> None:
        self._lib.gobject.g_object_set(
            ctypes.c_void_p(instance), name.encode(), ctypes.c_int(value), None
        )

    def _checked(self, function: str, *arguments: Any, device: bool = True) -> Any:
        """Call a function that may fail: one of the device, of the camera, or that opens one."""
        first: tuple[Any, ...] = ()
        if function != "arv_camera_new":
            if self._camera is None:
                raise AravisError("the camera is closed", DEVICE_DOMAIN, NOT_FOUND)
            first = (self._device if device else self._camera,)
        taken = [a.encode() if isinstance(a, str) else a for a in arguments]
        with _reported(self._lib) as error:
            found = getattr(self._arv, function)(*first, *taken, byref(error))
        return found


@contextlib.contextmanager
def _reported(library: AravisLibrary) -> Iterator[Any]:
    """Yield a place for GLib's error, and raise AravisError if one was put there."""
    error = POINTER(GError)()
    yield error
    if not error:
        return
    found = error.contents
    domain = library.glib.g_quark_to_string(found.domain) or b""
    message = (found.message or b"").decode(errors="replace")
    raised = AravisError(message, domain.decode(), found.code)
    library.glib.g_error_free(error)
    raise raised
