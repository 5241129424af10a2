"""What driver and display process say to each other, and the log they share.

One datagram of a socket pair a message, in MessagePack; arrays go beside it as a descriptor of
shared memory. The driver asks, the process answers each request once: `Ready`, `Done`, or `Failed`.
The only thing it says unasked is `Failed`, before it ends.
"""

from __future__ import annotations

import array
import enum
import socket
from typing import Any, Generic, TypeVar

import msgspec

from pdcd.panels.map import Map
from pdcd.presenter.memory import Slot
from pdcd.presenter.options import Options


class Mode(msgspec.Struct, frozen=True):
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

    options: Options
    projector: Mode
    mask: Mode
    plane_order: str | None = None
    """Colours of bit planes, where a refresh shows 24 rows; None where it shows one."""


class Load(msgspec.Struct, frozen=True, tag=True):
    """Take over `Frames`; its arrays are in the memory that comes along."""

    slots: list[Slot]
    grid: tuple[int, int]
    lattice: tuple[int, int]
    window: str


class Play(msgspec.Struct, frozen=True, tag=True):
    """Show rows of the loaded frames; `Head` and `Column` of the memory tell how far and when.

    The memory holds `primal` and `dual`, (refreshes, planes) int32: rows of the frames, -1 for
    black. abort : go black as soon as a refresh with the mask open lasted too long.
    """

    slots: list[Slot]
    abort: bool = False
    stalls: bool = True
    """Whether the stalls of the options are for this pass."""


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
    """By how much the mask's vblank follows the projector's; None where it could not be measured,
    or drifts."""


class Done(msgspec.Struct, frozen=True, tag=True):
    """The request is fulfilled."""


class Failed(msgspec.Struct, frozen=True, tag=True):
    """An error of `pdcd.errors` by its kind; `alive` is whether the process can go on."""

    kind: str
    message: str
    hint: str | None
    alive: bool


Request = Open | Load | Play | Show | Black | Quit
Reply = Ready | Done | Failed


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
    """When it began to be sent to the panels, on CLOCK_MONOTONIC."""
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

_LARGEST_BYTES = 1 << 20
_encoder = msgspec.msgpack.Encoder()


T = TypeVar("T")


class Channel(Generic[T]):
    """One end of the socket pair, where messages T are received: `Request` or `Reply`."""

    def __init__(self, sock: socket.socket, kind: Any) -> None:
        self.sock = sock
        self._decoder: msgspec.msgpack.Decoder[T] = msgspec.msgpack.Decoder(kind)

    def send(self, message: Request | Reply, fd: int | None = None) -> None:
        """Send one message, with a descriptor; OSError when the other end is gone."""
        fds = [] if fd is None else [fd]
        rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", fds))] if fds else []
        self.sock.sendmsg([_encoder.encode(message)], rights)

    def receive(self) -> tuple[T, int | None]:
        """The next message and its descriptor; EOFError when the other end is gone."""
        try:
            data, fds, _, _ = socket.recv_fds(self.sock, _LARGEST_BYTES, 1)
        except ConnectionResetError:
            # It ended with something unread, which is told first; what it said is still to come.
            data, fds, _, _ = socket.recv_fds(self.sock, _LARGEST_BYTES, 1)
        if not data:
            raise EOFError
        return self._decoder.decode(data), fds[0] if fds else None


def pair() -> tuple[socket.socket, socket.socket]:
    """Two connected ends that keep messages apart."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
