"""The X Present extension's events, by libxcb-present through ctypes.

Source: presentproto 1.2 (CompleteNotify, NotifyMSC) and xcb/present.h for the layout of the event.
ust is CLOCK_MONOTONIC in microseconds on Linux servers; msc counts vblanks.
"""

from __future__ import annotations

import ctypes
import select
import time
from typing import Any

from pdcd.errors import DeviceLost
from pdcd.presenter.xconnection import make_server_lost

COMPLETE_NOTIFY = 1
COMPLETE_MASK = 2
KIND_PIXMAP, KIND_MSC = 0, 1
MODE_FLIP = 1


class _Extension(ctypes.Structure):
    _fields_ = (("name", ctypes.c_char_p), ("global_id", ctypes.c_int))


class CompleteNotify(ctypes.LittleEndianStructure):
    """xcb_present_complete_notify_event_t; libxcb puts full_sequence at byte 32 of any event."""

    _pack_ = 1
    _layout_ = "ms"  # belongs to _pack_; required from Python 3.14 on
    _fields_ = (
        ("response_type", ctypes.c_uint8),
        ("extension", ctypes.c_uint8),
        ("sequence", ctypes.c_uint16),
        ("length", ctypes.c_uint32),
        ("event_type", ctypes.c_uint16),
        ("kind", ctypes.c_uint8),
        ("mode", ctypes.c_uint8),
        ("event", ctypes.c_uint32),
        ("window", ctypes.c_uint32),
        ("serial", ctypes.c_uint32),
        ("ust", ctypes.c_uint64),
        ("full_sequence", ctypes.c_uint32),
        ("msc", ctypes.c_uint64),
    )


class PresentEvents:
    """CompleteNotify events of one window, on an X connection of their own.

    After `wait` returns True, `ns`, `msc` and `flipped` are those of the event.
    """

    def __init__(self, display: str, window: int) -> None:
        try:
            self._xcb, self._present, self._libc = _libraries()
        except OSError as err:
            raise DeviceLost(
                f"the X Present library is missing: {err}",
                device="display",
                hint="apt-get install libxcb-present0",
            ) from err
        self._connection = self._xcb.xcb_connect(display.encode(), None)
        if self._xcb.xcb_connection_has_error(self._connection):
            raise make_server_lost(display, "connection refused")
        self._window = window
        extension = _Extension.in_dll(self._present, "xcb_present_id")
        # The server answers no event before it knows which version the client speaks.
        cookie = self._present.xcb_present_query_version(self._connection, 1, 2)
        self._libc.free(
            self._present.xcb_present_query_version_reply(self._connection, cookie, None)
        )
        name = self._xcb.xcb_generate_id(self._connection)
        self._events = self._xcb.xcb_register_for_special_xge(
            self._connection, ctypes.byref(extension), name, None
        )
        self._present.xcb_present_select_input(self._connection, name, window, COMPLETE_MASK)
        self._xcb.xcb_flush(self._connection)
        self._poller = select.poll()
        self._poller.register(self._xcb.xcb_get_file_descriptor(self._connection), select.POLLIN)
        self._display = display
        self._serial = 0
        self._asked = False
        self.ns = 0
        self.msc = 0
        self.flipped = 0

    def ask(self, msc: int) -> None:
        """Ask for an event at vblank `msc`; it comes at once when that has passed."""
        self._serial += 1
        self._present.xcb_present_notify_msc(
            self._connection, self._window, self._serial, msc, 0, 0
        )
        self._xcb.xcb_flush(self._connection)
        self._asked = True

    def wait(self, kind: int, timeout_s: float) -> bool:
        """Take the next event of a kind; False when none comes in time.

        Raises DeviceLost when the server is gone.
        """
        deadline_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        woken: object = None
        if self._asked and kind == KIND_MSC:
            # The answer cannot be among events read earlier, so these need not be searched first.
            woken = self._poller.poll(timeout_s * 1e3)
        self._asked = False
        while True:
            pointer = self._xcb.xcb_poll_for_special_event(self._connection, self._events)
            if pointer:
                event = CompleteNotify.from_address(pointer)
                wanted = event.event_type == COMPLETE_NOTIFY and event.kind == kind
                if wanted:
                    self.ns, self.msc = event.ust * 1000, event.msc
                    self.flipped = int(event.mode == MODE_FLIP)
                self._libc.free(pointer)
                if wanted:
                    return True
                continue
            # When the server is gone, the poll wakes without an event.
            if woken and self._xcb.xcb_connection_has_error(self._connection):
                raise make_server_lost(self._display, "it ended the connection")
            left_ms = (deadline_ns - time.monotonic_ns()) * 1e-6
            if left_ms <= 0:
                return False
            woken = self._poller.poll(left_ms)

    def close(self) -> None:
        """Release the connection."""
        if self._connection:
            self._xcb.xcb_disconnect(self._connection)
            self._connection = None


def _libraries() -> tuple[Any, Any, Any]:
    """libxcb, libxcb-present and libc with the signatures used here."""
    xcb, present = ctypes.CDLL("libxcb.so.1"), ctypes.CDLL("libxcb-present.so.0")
    libc = ctypes.CDLL(None)
    pointer, u32, u64 = ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint64
    signatures: list[tuple[Any, Any, list[Any]]] = [
        (xcb.xcb_connect, pointer, [ctypes.c_char_p, pointer]),
        (xcb.xcb_connection_has_error, ctypes.c_int, [pointer]),
        (xcb.xcb_generate_id, u32, [pointer]),
        (xcb.xcb_flush, ctypes.c_int, [pointer]),
        (xcb.xcb_disconnect, None, [pointer]),
        (xcb.xcb_get_file_descriptor, ctypes.c_int, [pointer]),
        (xcb.xcb_register_for_special_xge, pointer, [pointer, pointer, u32, pointer]),
        (xcb.xcb_poll_for_special_event, pointer, [pointer, pointer]),
        (present.xcb_present_query_version, u32, [pointer, u32, u32]),
        (present.xcb_present_query_version_reply, pointer, [pointer, u32, pointer]),
        (present.xcb_present_select_input, u32, [pointer, u32, u32, u32]),
        (present.xcb_present_notify_msc, u32, [pointer, u32, u32, u64, u64, u64]),
        (libc.free, None, [pointer]),
    ]
    for function, result, arguments in signatures:
        function.restype, function.argtypes = result, arguments
    return xcb, present, libc
