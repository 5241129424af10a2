"""The messages between driver and display process, and the memory they share.

Messages are MessagePack. Arrays are sent along as a descriptor of anonymous memory, which has no
name, so nothing is left behind however either process ends. The driver asks, the process answers
each request once: `Ready`, `Done`, or `Failed`. The only message it sends unasked is `Failed`,
before it ends.
"""

from __future__ import annotations

import enum
import mmap
import os
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.child import Codec
from pdcd.panels.map import Map
from pdcd.presenter.options import X11Options

_ALIGN_BYTES = 64
"""Each array starts on a cache line."""


class PanelMode(msgspec.Struct, frozen=True):
    """What a panel must be: where its pixels lie on the field, and its nominal refresh."""

    map: Map
    refresh_hz: float

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.map.size_px


class Rect(msgspec.Struct, frozen=True):
    """A panel on the X screen, in pixels from the screen's upper left corner."""

    x: int
    y: int
    width: int
    height: int


class Open(msgspec.Struct, frozen=True, tag=True):
    """Open both panels, black, and measure."""

    options: X11Options
    projector: PanelMode
    mask: PanelMode
    plane_order: str | None = None
    """Colours of bit planes, where a refresh shows 24 rows; None where it shows one row."""


class Slot(msgspec.Struct, frozen=True):
    """Where one array lies in the memory."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    offset: int


class Load(msgspec.Struct, frozen=True, tag=True):
    """Take over `Frames`; its arrays are in the memory that comes along."""

    slots: list[Slot]
    grid: tuple[int, int]
    lattice: tuple[int, int]
    window: str


class Play(msgspec.Struct, frozen=True, tag=True):
    """Show rows of the loaded frames; `Head` and `Column` in the memory say how far and when.

    The memory holds `primal` and `dual`, (refreshes, planes) int32: rows of the frames, -1 for
    black. abort : go black as soon as a refresh with the mask open lasted too long.
    """

    slots: list[Slot]
    abort: bool = False
    stalls: bool = True
    """Whether the stalls of the options apply to this pass."""


class Show(msgspec.Struct, frozen=True, tag=True):
    """Hold one row of the loaded frames."""

    row: int = 0


class Black(msgspec.Struct, frozen=True, tag=True):
    """Both panels black; answered when they are."""


class Quit(msgspec.Struct, frozen=True, tag=True):
    """Black, close the windows, end."""


class Ready(msgspec.Struct, frozen=True, tag=True):
    """The panels are open and black.

    refresh_hz is measured by the time source. identity says in words what was found: the outputs,
    the renderer, and what the operating system permitted.
    """

    source: str
    refresh_hz: float
    identity: dict[str, str]
    lag_s: float | None = None
    """How much later the mask's vblank comes than the projector's; None where it could not be
    measured, or drifts."""
    warnings: tuple[str, ...] = ()
    """What the user should know about the panels, each with what to do."""


class Done(msgspec.Struct, frozen=True, tag=True):
    """The request is fulfilled."""


class Failed(msgspec.Struct, frozen=True, tag=True):
    """An error of `pdcd.errors` by its kind; `alive` is whether the process can go on."""

    kind: str
    message: str
    hint: str | None
    alive: bool


DisplayRequest = Open | Load | Play | Show | Black | Quit
DisplayReply = Ready | Done | Failed

_encode = msgspec.msgpack.Encoder().encode
REPLIES: Codec[DisplayReply] = Codec(_encode, msgspec.msgpack.Decoder(DisplayReply).decode)
"""The messages that the driver receives."""
REQUESTS: Codec[DisplayRequest] = Codec(_encode, msgspec.msgpack.Decoder(DisplayRequest).decode)
"""The messages that the process receives."""


class Head(enum.IntEnum):
    """Entries of the shared `head`, int64."""

    SHOWN = 0
    """Entries of the log that are complete."""
    STOP = 1
    """Set by the driver: go black now."""
    MISSED = 2
    """Refreshes lost so far."""
    FIRST = 3
    """Set by the driver: the refresh from which stalls are counted."""
    SPOILT = 4
    """Refreshes with the mask open that lasted too long."""


HEAD_SIZE = 8


class Column(enum.IntEnum):
    """Columns of the shared `log`, int64, one row for each refresh that was shown."""

    NS = 0
    """When the refresh began to be sent to the panels, on CLOCK_MONOTONIC."""
    MSC = 1
    """Number of that vblank."""
    PUT_NS = 2
    """When its drawing began."""
    SWAP_NS = 3
    """When it was handed to the display system."""
    CPU_NS = 4
    """Processor time of the loop's thread since it began."""
    FLIPPED = 5
    """1 when the display system reported a page flip, 0 when a copy, or nothing."""


LOG_COLUMNS = len(Column)


def copy_to_shared_memory(
    arrays: Mapping[str, NDArray[Any]],
) -> tuple[int, list[Slot], dict[str, NDArray[Any]]]:
    """Copy arrays into new shared memory; returns its descriptor, their places and the copies.

    The caller closes the descriptor; the copies stay valid.
    """
    slots, offset = [], 0
    for name, array in arrays.items():
        slots.append(Slot(name, array.dtype.str, array.shape, offset))
        offset += -(-array.nbytes // _ALIGN_BYTES) * _ALIGN_BYTES
    fd = os.memfd_create("pdcd", os.MFD_CLOEXEC)
    os.ftruncate(fd, max(offset, _ALIGN_BYTES))
    views = map_shared_arrays(fd, slots)
    for name, array in arrays.items():
        views[name][...] = array
    return fd, slots, views


def map_shared_arrays(fd: int, slots: list[Slot]) -> dict[str, NDArray[Any]]:
    """Map the arrays behind a descriptor, writable; the descriptor may be closed afterwards."""
    memory = mmap.mmap(fd, os.fstat(fd).st_size)
    found = {}
    for slot in slots:
        count = int(np.prod(slot.shape, dtype=np.int64))
        flat = np.frombuffer(memory, dtype=np.dtype(slot.dtype), count=count, offset=slot.offset)
        found[slot.name] = flat.reshape(slot.shape)
    return found
