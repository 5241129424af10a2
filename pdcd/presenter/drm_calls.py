"""Calls of the kernel for graphics cards: layouts, request numbers, and the one who makes them.

Source: Linux, include/uapi/drm/drm.h and drm_mode.h. Request numbers are put together as in
asm-generic/ioctl.h, which x86, ARM and RISC-V use. None of these calls needs to be DRM master.
Never run on a real card.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import select
from pathlib import Path
from typing import Any, Protocol

_U16, _U32, _U64, _I64 = ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint64, ctypes.c_int64
_NAME = ctypes.c_char * 32


class GetSequence(ctypes.Structure):
    """drm_crtc_get_sequence: the last vblank of a CRTC. active : the CRTC shows something."""

    _fields_ = (("crtc_id", _U32), ("active", _U32), ("sequence", _U64), ("sequence_ns", _I64))


class QueueSequence(ctypes.Structure):
    """drm_crtc_queue_sequence: wish for an event at a vblank; `user_data` comes back with it."""

    _fields_ = (("crtc_id", _U32), ("flags", _U32), ("sequence", _U64), ("user_data", _U64))


class SequenceEvent(ctypes.Structure):
    """drm_event_crtc_sequence; time_ns is CLOCK_MONOTONIC, when the first pixel goes out."""

    _fields_ = (
        ("type", _U32),
        ("length", _U32),
        ("user_data", _U64),
        ("time_ns", _I64),
        ("sequence", _U64),
    )


class ModeInfo(ctypes.Structure):
    """drm_mode_modeinfo."""

    _fields_ = (
        ("clock", _U32),
        *((name, _U16) for name in ("hdisplay", "hsync_start", "hsync_end", "htotal", "hskew")),
        *((name, _U16) for name in ("vdisplay", "vsync_start", "vsync_end", "vtotal", "vscan")),
        *((name, _U32) for name in ("vrefresh", "flags", "type")),
        ("name", _NAME),
    )


class GetResources(ctypes.Structure):
    """drm_mode_card_res: numbers of all connectors of a card."""

    _fields_ = (
        *((f"{name}_id_ptr", _U64) for name in ("fb", "crtc", "connector", "encoder")),
        *((f"count_{name}", _U32) for name in ("fbs", "crtcs", "connectors", "encoders")),
        *((name, _U32) for name in ("min_width", "max_width", "min_height", "max_height")),
    )


class GetCrtc(ctypes.Structure):
    """drm_mode_crtc: what a CRTC shows; no mode when it is off."""

    _fields_ = (
        ("set_connectors_ptr", _U64),
        ("count_connectors", _U32),
        *((name, _U32) for name in ("crtc_id", "fb_id", "x", "y", "gamma_size", "mode_valid")),
        ("mode", ModeInfo),
    )


class GetEncoder(ctypes.Structure):
    """drm_mode_get_encoder: which CRTC feeds it, 0 for none."""

    _fields_ = tuple(
        (name, _U32)
        for name in (
            "encoder_id", "encoder_type", "crtc_id", "possible_crtcs", "possible_clones",
        )
    )  # fmt: skip


class GetConnector(ctypes.Structure):
    """drm_mode_get_connector: which encoder feeds it, 0 for none, and its properties."""

    _fields_ = (
        *((f"{name}_ptr", _U64) for name in ("encoders", "modes", "props", "prop_values")),
        *((f"count_{name}", _U32) for name in ("modes", "props", "encoders")),
        *((name, _U32) for name in ("encoder_id", "connector_id", "connector_type")),
        *((name, _U32) for name in ("connector_type_id", "connection", "mm_width", "mm_height")),
        *((name, _U32) for name in ("subpixel", "pad")),
    )


class GetProperty(ctypes.Structure):
    """drm_mode_get_property: name of a property."""

    _fields_ = (
        *((name, _U64) for name in ("values_ptr", "enum_blob_ptr")),
        *((name, _U32) for name in ("prop_id", "flags")),
        ("name", _NAME),
        *((name, _U32) for name in ("count_values", "count_enum_blobs")),
    )


class GetBlob(ctypes.Structure):
    """drm_mode_get_blob: bytes that a property points to."""

    _fields_ = (("blob_id", _U32), ("length", _U32), ("data", _U64))


def _read_write(number: int, layout: type[ctypes.Structure]) -> int:
    """_IOWR('d', number, layout)."""
    return 3 << 30 | ctypes.sizeof(layout) << 16 | ord("d") << 8 | number


DROP_MASTER = ord("d") << 8 | 0x1F
GET_SEQUENCE = _read_write(0x3B, GetSequence)
QUEUE_SEQUENCE = _read_write(0x3C, QueueSequence)
GET_RESOURCES = _read_write(0xA0, GetResources)
GET_CRTC = _read_write(0xA1, GetCrtc)
GET_ENCODER = _read_write(0xA6, GetEncoder)
GET_CONNECTOR = _read_write(0xA7, GetConnector)
GET_PROPERTY = _read_write(0xAA, GetProperty)
GET_BLOB = _read_write(0xAC, GetBlob)

RELATIVE = 1
"""Flag of QUEUE_SEQUENCE: counted from now."""
SEQUENCE_EVENT = 3
"""Type of a SequenceEvent."""
EVENT_HEADER = 8
"""Bytes of type and length, with which every event begins."""

FOLDER = Path("/dev/dri")
_READ_BYTES = 4096
"""Room for all events that the kernel keeps for a reader."""


class Kernel(Protocol):
    """All that is asked of the kernel; every method raises OSError."""

    def nodes(self) -> tuple[str, ...]:
        """Paths of all cards, in order."""
        ...

    def open(self, node: str) -> int:
        """Open a card; its descriptor."""
        ...

    def call(self, fd: int, request: int, argument: Any = None) -> None:
        """Make a call; `argument` is one of the layouts, and holds the answer afterwards."""
        ...

    def read(self, fd: int, timeout_s: float) -> bytes:
        """Whole events that have come, b"" when none comes in time."""
        ...

    def close(self, fd: int) -> None:
        """Close a card."""
        ...


class Linux:
    """The kernel that this process runs on."""

    def nodes(self) -> tuple[str, ...]:
        """Paths of all cards, in order."""
        return tuple(sorted(str(path) for path in FOLDER.glob("card[0-9]*")))

    def open(self, node: str) -> int:
        """Open a card; its descriptor."""
        return os.open(node, os.O_RDWR | os.O_CLOEXEC | os.O_NONBLOCK)

    def call(self, fd: int, request: int, argument: Any = None) -> None:
        """Make a call, again after a signal."""
        while True:
            try:
                fcntl.ioctl(fd, request, 0 if argument is None else argument)
            except InterruptedError:
                continue
            return

    def read(self, fd: int, timeout_s: float) -> bytes:
        """Whole events that have come, b"" when none comes in time."""
        poller = select.poll()
        poller.register(fd, select.POLLIN)
        if not poller.poll(timeout_s * 1e3):
            return b""
        try:
            return os.read(fd, _READ_BYTES)
        except BlockingIOError:
            return b""

    def close(self, fd: int) -> None:
        """Close a card."""
        os.close(fd)
