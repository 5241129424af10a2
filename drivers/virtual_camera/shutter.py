"""The virtual camera's shutter and memory: exposures, their files, and the records about them."""

from __future__ import annotations

import logging
import struct
from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

from pdcd.driver import Clock

from ..ptp.codes import EosEvent, ObjectFormat
from ..ptp.datasets import ObjectInfo
from ..ptp.events import EosRecord, ObjectAdded, PlainRecord
from .develop import Develop, develop_at_once
from .faults import FaultScript
from .model import STORAGE

logger = logging.getLogger(__name__)

ROOT_HANDLE = 0
DCIM = 0x41000000
FOLDER_HANDLE = 0x41900000
_READOUT_NS = 200_000_000
"""From the end of an exposure until its file is announced."""
_FIRST_HANDLE = 0x91900011
_HANDLE_STEP = 0x10
_REMEMBERED = 16


@dataclass(frozen=True)
class CameraExposure:
    """When the shutter was open, in ns of the injected clock, and the settings it was taken with.

    `f_number` is None for a lens that does not report it.
    """

    open_ns: int
    close_ns: int
    iso: int
    f_number: float | None


class ShutterFilm(Protocol):
    """What lies behind the shutter: the mock bench, or a scene of its own."""

    def open(self, asked_ns: int) -> int:
        """Tell the shutter to open; returns the time, in ns, at which it really opens."""
        ...

    def close(self, asked_ns: int) -> int:
        """Tell the shutter to close; returns the time, in ns, at which it really closes."""
        ...

    def make_raw(self, exposure: CameraExposure) -> bytes:
        """The RAW file of the exposure that has just ended."""
        ...


@dataclass
class _Stored:
    """One file: its bytes, what the camera says of it, and whether it is on the card."""

    data: bytes
    info: ObjectInfo
    on_card: bool


class FileStore:
    """Files on the card and in memory, by handle, below the folders that cameras have."""

    def __init__(self) -> None:
        self.files: dict[int, _Stored] = {}
        self._next = _FIRST_HANDLE
        self._count = 0

    @property
    def in_ram(self) -> int:
        """Files that nobody has fetched from memory."""
        return sum(not stored.on_card for stored in self.files.values())

    def add(self, data: bytes, *, on_card: bool, announced_bytes: int) -> ObjectAdded:
        """Keep a file; returns the record that announces it."""
        self._count += 1
        handle, self._next = self._next, self._next + _HANDLE_STEP
        name = f"IMG_{(self._count - 1) % 9999 + 1:04d}.CR2"
        parent = FOLDER_HANDLE if on_card else ROOT_HANDLE
        info = ObjectInfo(STORAGE, ObjectFormat.CANON_CR2, announced_bytes, name, parent)
        self.files[handle] = _Stored(data, info, on_card)
        return ObjectAdded(
            handle, ObjectFormat.CANON_CR2, announced_bytes, name, on_card,
            STORAGE if on_card else 0, parent,
        )  # fmt: skip

    def info(self, handle: int) -> ObjectInfo | None:
        """What the camera says of a file or folder."""
        if handle == DCIM:
            return ObjectInfo(STORAGE, ObjectFormat.ASSOCIATION, 0, "DCIM", ROOT_HANDLE)
        if handle == FOLDER_HANDLE:
            return ObjectInfo(STORAGE, ObjectFormat.ASSOCIATION, 0, "100CANON", DCIM)
        stored = self.files.get(handle)
        return stored.info if stored else None

    def children(self, parent: int) -> list[int]:
        """Handles on the card in a folder; 0xFFFFFFFF and 0 are the card's root."""
        if parent in (ROOT_HANDLE, 0xFFFFFFFF):
            return [DCIM]
        if parent == DCIM:
            return [FOLDER_HANDLE]
        if parent == FOLDER_HANDLE:
            return [handle for handle, stored in self.files.items() if stored.on_card]
        return []

    @property
    def everything(self) -> list[int]:
        """All handles on the card, folders included."""
        return [DCIM, FOLDER_HANDLE, *self.children(FOLDER_HANDLE)]


class CameraShutter:
    """Opens, closes, and announces the file when it is there.

    `opened` counts all exposures begun: a client that sends a release twice raises it by two.
    """

    def __init__(
        self,
        clock: Clock,
        film: ShutterFilm,
        script: FaultScript,
        store: FileStore,
        develop: Develop = develop_at_once,
    ) -> None:
        self._clock = clock
        self._film = film
        self._script = script
        self._store = store
        self._develop = develop
        self._making: Future[bytes] | None = None
        self._open_ns: int | None = None
        self._close_at_ns: int | None = None
        self._iso, self._on_card = 100, False
        self._f_number: float | None = None
        self._ready_ns = 0
        self._due: list[tuple[int, EosRecord]] = []
        self._told_s = 0
        self.opened = 0
        self.exposures: deque[CameraExposure] = deque(maxlen=_REMEMBERED)
        """The last exposures made, oldest first."""

    @property
    def is_open(self) -> bool:
        """Whether light falls on the sensor."""
        self._settle()
        return self._open_ns is not None

    @property
    def busy(self) -> bool:
        """Whether an exposure, its dark frame or its file is under way."""
        self._collect()
        return self.is_open or self._making is not None or self._clock.now_ns() < self._ready_ns

    def open(
        self, iso: int, f_number: float | None, *, on_card: bool, for_s: float | None = None
    ) -> None:
        """Begin an exposure, of `for_s` seconds or until `close`."""
        now_ns = self._clock.now_ns()
        self._iso, self._f_number, self._on_card = iso, f_number, on_card
        self._open_ns = self._film.open(now_ns)
        self._close_at_ns = None if for_s is None else self._open_ns + round(for_s * 1e9)
        self._told_s = 0
        self.opened += 1

    def close(self) -> None:
        """End an exposure; nothing happens when there is none."""
        self._end(self._clock.now_ns())

    def records(self) -> list[EosRecord]:
        """The records that are due by now, each once."""
        self._settle()
        self._collect()
        now_ns = self._clock.now_ns()
        told = [record for due_ns, record in self._due if due_ns <= now_ns]
        self._due = [(due_ns, record) for due_ns, record in self._due if due_ns > now_ns]
        if self._open_ns is not None and self._close_at_ns is None:
            seconds = max(0, (now_ns - self._open_ns) // 1_000_000_000)
            if seconds > self._told_s:
                self._told_s = seconds
                told.append(PlainRecord(EosEvent.BULB_EXPOSURE_TIME, struct.pack("<I", seconds)))
        return told

    @property
    def has_news(self) -> bool:
        """Whether the announcement of a file is due."""
        self._collect()
        now_ns = self._clock.now_ns()
        return any(due_ns <= now_ns for due_ns, _ in self._due)

    def _settle(self) -> None:
        """End a timed exposure whose time is over."""
        if self._close_at_ns is not None and self._clock.now_ns() >= self._close_at_ns:
            self._end(self._close_at_ns)

    def _end(self, asked_ns: int) -> None:
        if self._open_ns is None:
            return
        open_ns, self._open_ns, self._close_at_ns = self._open_ns, None, None
        close_ns = self._film.close(asked_ns)
        exposure = CameraExposure(open_ns, close_ns, self._iso, self._f_number)
        self.exposures.append(exposure)
        self._making = self._develop(lambda: self._film.make_raw(exposure))
        dark_ns = (close_ns - open_ns) if self._script.long_exposure_nr else 0
        self._ready_ns = close_ns + dark_ns + _READOUT_NS
        self._collect()

    def _collect(self) -> None:
        """Take in the file of the last exposure once it is made, so that it can be announced."""
        made = self._making
        if made is None or not made.done():
            return
        self._making = None
        try:
            data = made.result()
        # A film may raise anything; the camera goes on, without that photo.
        except Exception as err:
            logger.error("no file was made error=%s: %s", type(err).__name__, err)
            return
        kind = self._script.file
        if kind == "none":
            return
        announced = len(data)
        if kind == "truncated":
            data = data[: len(data) // 2]
        added = self._store.add(data, on_card=self._on_card, announced_bytes=announced)
        late_ns = round(self._script.late_s * 1e9) if kind == "late" else 0
        self._due += [(self._ready_ns + late_ns, added)] * (2 if kind == "twice" else 1)
