"""A kernel with graphics cards whose vblanks are worked out from a formula.

It speaks in bytes: layouts and request numbers are written down here a second time, from a C
compiler's answers on libdrm 2.4.114's drm.h (x86-64), so that `pdcd.presenter.drm_calls` is not
held against itself. It keeps the kernel's habits that matter: arrays are filled only where there is
room, vblanks more than 2**23 ago count as still to come, stamps are those of the first pixel and
may lie ahead. It does not model modesets, masters, hot-plugging, or a full queue of events.
"""

from __future__ import annotations

import ctypes
import errno
import os
import struct
import time
from dataclasses import dataclass, field
from typing import Any

PERIOD_NS = 16_666_667
LEAD_NS = 400_000
"""The interrupt comes at the start of the blanking, the first pixel is due at its end."""
PASSED = 1 << 23

DROP_MASTER = 0x641F
GET_SEQUENCE, QUEUE_SEQUENCE = 0xC018643B, 0xC018643C
GET_RESOURCES, GET_CRTC, GET_ENCODER = 0xC04064A0, 0xC06864A1, 0xC01464A6
GET_CONNECTOR, GET_PROPERTY, GET_BLOB = 0xC05064A7, 0xC04064AA, 0xC01064AC

PROPERTIES = {1: b"DPMS", 2: b"EDID", 3: b"link-status"}
BLOB = 900
"""Number of a connector's EDID blob: this plus the connector's."""


@dataclass
class Crtc:
    """A CRTC, its mode's size, and its vblanks: number `n` is at first_ns + n period_ns."""

    number: int
    size: tuple[int, int]
    period_ns: float = PERIOD_NS
    first_ns: int = 0
    active: bool = True
    stuck: bool = False
    """Its counter stands still, and no event ever comes."""
    uncounted: bool = False
    """It has no vblank interrupt."""

    def count(self, now_ns: int) -> int:
        return 5 if self.stuck else int((now_ns + LEAD_NS - self.first_ns) / self.period_ns)

    def stamp_ns(self, number: int) -> int:
        return self.first_ns + round(number * self.period_ns)


@dataclass
class Connector:
    number: int
    crtc: Crtc | None
    edid: bytes = b""

    @property
    def encoder(self) -> int:
        return self.number + 1000


@dataclass
class Opened:
    card: str
    events: list[tuple[int, bytes]] = field(default_factory=list)
    """When each is to be read, and its bytes."""


class FakeKernel:
    """Cards by their paths; `failures` maps a path or a request number to an errno.

    Time is the computer's own with `real_time`, or else `now_ns`, which waiting moves on.
    """

    def __init__(self, cards: dict[str, list[Connector]], *, real_time: bool = False) -> None:
        self.cards = cards
        self.failures: dict[str | int, int] = {}
        self.stale: list[bytes] = []
        """Events that the next read finds before all others."""
        self._real_time = real_time
        self._now_ns = 1_000_000_000_000
        self._opened: dict[int, Opened] = {}
        self.requests: list[int] = []

    @property
    def now_ns(self) -> int:
        return time.monotonic_ns() if self._real_time else self._now_ns

    @now_ns.setter
    def now_ns(self, now_ns: int) -> None:
        self._now_ns = now_ns

    @property
    def open_files(self) -> int:
        return len(self._opened)

    def sleep_until(self, t_ns: int) -> None:
        if self._real_time:
            time.sleep(max(0, t_ns - time.monotonic_ns()) * 1e-9)
        else:
            self._now_ns = max(self._now_ns, t_ns)

    def nodes(self) -> tuple[str, ...]:
        return tuple(sorted(self.cards))

    def open(self, node: str) -> int:
        self._fail(node)
        fd = 10 + max(self._opened, default=0)
        self._opened[fd] = Opened(node)
        return fd

    def close(self, fd: int) -> None:
        del self._opened[fd]

    def call(self, fd: int, request: int, argument: Any = None) -> None:
        opened = self._opened[fd]
        self.requests.append(request)
        self._fail(request)
        if request == DROP_MASTER:
            assert argument is None
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))  # X is master
        memory = memoryview(argument).cast("B")
        # The request number carries the size of its argument.
        assert len(memory) == request >> 16 & 0x3FFF
        answer = bytearray(memory)
        self._answers[request](self, opened, answer)
        memory[:] = answer

    def read(self, fd: int, timeout_s: float) -> bytes:
        events = self._opened[fd].events
        stale, self.stale = b"".join(self.stale), []
        if stale:
            return stale
        until_ns = self.now_ns + round(timeout_s * 1e9)
        due_ns = min((at_ns for at_ns, _ in events), default=until_ns)
        self.sleep_until(min(due_ns, until_ns))
        ready = [event for event in events if event[0] <= self.now_ns]
        for event in ready:
            events.remove(event)
        return b"".join(data for _, data in ready)

    def _fail(self, key: str | int) -> None:
        if key in self.failures:
            number = self.failures[key]
            raise OSError(number, os.strerror(number))

    def _connectors(self, opened: Opened) -> list[Connector]:
        return self.cards[opened.card]

    def _crtc(self, opened: Opened, number: int) -> Crtc:
        for connector in self._connectors(opened):
            if connector.crtc is not None and connector.crtc.number == number:
                return connector.crtc
        raise OSError(errno.ENOENT, os.strerror(errno.ENOENT))

    def _connector(self, opened: Opened, number: int) -> Connector:
        for connector in self._connectors(opened):
            if connector.number == number:
                return connector
        raise OSError(errno.ENOENT, os.strerror(errno.ENOENT))

    def _resources(self, opened: Opened, answer: bytearray) -> None:
        numbers = [connector.number for connector in self._connectors(opened)]
        (address,) = struct.unpack_from("=Q", answer, 16)
        (room,) = struct.unpack_from("=I", answer, 40)
        _fill(address, "I", numbers, room)
        struct.pack_into("=IIII", answer, 32, 0, len(numbers), len(numbers), len(numbers))

    def _get_connector(self, opened: Opened, answer: bytearray) -> None:
        (number,) = struct.unpack_from("=I", answer, 48)
        connector = self._connector(opened, number)
        _, modes, names, values = struct.unpack_from("=QQQQ", answer, 0)
        modes_room, room, encoders_room = struct.unpack_from("=III", answer, 32)
        assert modes and modes_room, "the kernel would look for a panel anew"
        assert not encoders_room
        _fill(names, "I", list(PROPERTIES), room)
        blob = BLOB + number if connector.edid else 0
        _fill(values, "Q", [0, blob, 0], room)
        struct.pack_into("=III", answer, 32, 7, len(PROPERTIES), 1)
        encoder = connector.encoder if connector.crtc else 0
        struct.pack_into("=II", answer, 44, encoder, number)
        struct.pack_into("=I", answer, 60, 1)

    def _get_encoder(self, opened: Opened, answer: bytearray) -> None:
        (number,) = struct.unpack_from("=I", answer, 0)
        crtc = self._connector(opened, number - 1000).crtc
        assert crtc is not None
        struct.pack_into("=I", answer, 8, crtc.number)

    def _get_crtc(self, opened: Opened, answer: bytearray) -> None:
        (number,) = struct.unpack_from("=I", answer, 12)
        crtc = self._crtc(opened, number)
        struct.pack_into("=I", answer, 32, int(crtc.active))
        struct.pack_into("=H", answer, 36 + 4, crtc.size[0])
        struct.pack_into("=H", answer, 36 + 14, crtc.size[1])

    def _property(self, _: Opened, answer: bytearray) -> None:
        (number,) = struct.unpack_from("=I", answer, 16)
        struct.pack_into("=32s", answer, 24, PROPERTIES[number])

    def _blob(self, opened: Opened, answer: bytearray) -> None:
        number, length, address = struct.unpack_from("=IIQ", answer, 0)
        data = self._connector(opened, number - BLOB).edid
        if length == len(data):
            ctypes.memmove(address, data, len(data))
        struct.pack_into("=I", answer, 4, len(data))

    def _sequence(self, opened: Opened, answer: bytearray) -> None:
        (number,) = struct.unpack_from("=I", answer, 0)
        crtc = self._crtc(opened, number)
        if crtc.uncounted:
            raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))
        last = crtc.count(self.now_ns)
        struct.pack_into("=IQq", answer, 4, int(crtc.active), last, crtc.stamp_ns(last))

    def _queue(self, opened: Opened, answer: bytearray) -> None:
        number, flags, wanted, user_data = struct.unpack_from("=IIQQ", answer, 0)
        assert not flags & ~3, "EINVAL"
        crtc = self._crtc(opened, number)
        last = crtc.count(self.now_ns)
        wanted += last if flags & 1 else 0
        if (last - wanted) % (1 << 64) <= PASSED:
            at_ns, wanted = self.now_ns, last
        elif crtc.stuck or wanted < last:
            return  # and no event ever comes
        else:
            at_ns = crtc.stamp_ns(wanted) - LEAD_NS
        event = struct.pack("=IIQqQ", 3, 32, user_data, crtc.stamp_ns(wanted), wanted)
        opened.events.append((at_ns, event))
        struct.pack_into("=Q", answer, 8, wanted)

    _answers = {  # noqa: RUF012
        GET_RESOURCES: _resources,
        GET_CONNECTOR: _get_connector,
        GET_ENCODER: _get_encoder,
        GET_CRTC: _get_crtc,
        GET_PROPERTY: _property,
        GET_BLOB: _blob,
        GET_SEQUENCE: _sequence,
        QUEUE_SEQUENCE: _queue,
    }


def _fill(address: int, kind: str, numbers: list[int], room: int) -> None:
    """Write so many of these numbers as there is room for."""
    data = struct.pack(f"={len(numbers[:room])}{kind}", *numbers[:room])
    if data:
        ctypes.memmove(address, data, len(data))
