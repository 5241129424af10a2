"""Scripted DLPC900s for tests of their driver: a pyusb backend that writes down what it is sent.

No model of the device: it answers what a test lays down, takes tables apart by the guide's bytes
only as far as to know how long they run, and knows nothing of what may follow what.
"""

from __future__ import annotations

import errno
import struct
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import usb.core
from numpy.typing import NDArray

from drivers.dlpc900.display import Dlpc900Display
from drivers.virtual_dlpc900 import VirtualDmdBus
from drivers.virtual_usb import (
    OneInterfaceUsb,
    copy_reply,
    make_device_descriptor,
    make_string_descriptor,
)
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import Clock, DriverContext, SharedState
from pdcd.bench.tables import Config, DisplayConfig, PanelConfig
from pdcd.panels.frames import Frames
from pdcd.panels.patterns import pack_bits
from pdcd.panels.schedule import build_frames
from tests.dlpc900_reports import read_picture

SIZE = (96, 64)
ROW_US = 125
NO_DEVICE = usb.core.USBError("no such device", -4, errno.ENODEV)


def timed_out() -> usb.core.USBTimeoutError:
    return usb.core.USBTimeoutError("timed out", -7, errno.ETIMEDOUT)


class Sent(NamedTuple):
    """One command as the device was sent it."""

    flags: int
    command: int
    data: bytes


@dataclass
class ScriptedDmd:
    """One device. answers : of reads, by command. refuses : commands, with their error code."""

    clock: Clock
    serial: str
    port: tuple[int, ...]
    answers: dict[int, bytes] = field(default_factory=dict)
    refuses: dict[int, int] = field(default_factory=dict)
    on_report: Callable[[int], None] = lambda _: None
    silent: bool = False
    open_error: usb.core.USBError | None = None
    stale: int = 0
    wired: ScriptedDmd | None = None

    def __post_init__(self) -> None:
        self.sent: list[Sent] = []
        self.kernel = True
        self.reports = 0
        self.mode, self.code = 0, 0
        self.entries: dict[int, bytes] = {}
        self.table = (0, 0)
        self.order: tuple[int, ...] = ()
        self.runs_from_ns: int | None = None
        self.waits = False
        self.pictures: dict[tuple[int, int], bytes] = {}
        self._loads: dict[int, int] = {}
        self._packet = bytearray()
        self._replies: deque[bytes] = deque()

    def take(self, report: bytes) -> None:
        assert len(report) == 64
        self.on_report(self.reports)
        self.reports += 1
        self._packet += report
        length = 4 + int.from_bytes(self._packet[2:4], "little")
        assert length <= 512
        if len(self._packet) < length:
            return
        packet, self._packet = bytes(self._packet[:length]), bytearray()
        flags, sequence, _, command = struct.unpack_from("<BBHH", packet)
        self.sent.append(Sent(flags, command, packet[6:]))
        refused = command in self.refuses
        if refused:
            self.code = self.refuses[command]
        elif command not in (0x0100, 0x0101):
            self.code = 0
        if not refused and not flags & 0x80:
            self._obey(command, packet[6:])
        if flags & 0x40 and not self.silent:
            data = self._answer(command) if flags & 0x80 and not refused else b""
            for number in range(self.stale):
                self._replies.append(bytes([0x40, (sequence + 1 + number) % 256, 1, 0, 9]))
            head = struct.pack("<BBH", flags | (0x20 if refused else 0), sequence, len(data))
            self._replies.append((head + data).ljust(64, b"\0"))

    def give(self) -> bytes:
        if not self._replies:
            raise timed_out()
        return self._replies.popleft()

    def trigger(self) -> None:
        """An edge on TRIG_IN_1."""
        if self.waits:
            self.waits = False
            self.runs_from_ns = self.clock.now_ns()

    @property
    def running(self) -> bool:
        if self.waits or self.runs_from_ns is None:
            return self.waits
        lasts = sum(
            int.from_bytes(e[2:5], "little") + int.from_bytes(e[6:9], "little")
            for e in (self.entries[n] for n in self.order)
        )
        return not self.table[1] or self.clock.now_ns() < self.runs_from_ns + 1000 * lasts

    @property
    def black(self) -> bool:
        """Whether it shows nothing but its plane without light, or waits."""
        if self.waits:
            return True
        return self.running and all(not self.plane(*self.place_of(n)).any() for n in self.order)

    def place_of(self, entry: int) -> tuple[int, int]:
        both = int.from_bytes(self.entries[entry][10:12], "little")
        return both & 0x7FF, both >> 11

    def plane(self, picture: int, bit: int) -> NDArray[np.bool_]:
        """A plane as it is loaded, of the whole panel: bytes hold planes 16-23, 0-7, 8-15."""
        halves = [read_picture(data) for (n, _), data in sorted(self.pictures.items())
                  if n == picture]  # fmt: skip
        pixels = np.concatenate(halves, axis=1)
        return np.asarray(pixels[..., (1, 2, 0)[bit // 8]] >> bit % 8 & 1, dtype=np.bool_)

    def said(self, *commands: int) -> list[Sent]:
        return [one for one in self.sent if one.command in commands]

    def _obey(self, command: int, data: bytes) -> None:
        if command == 0x1A1B:
            self.mode = data[0]
        elif command == 0x1A34:
            self.entries[int.from_bytes(data[:2], "little")] = data
        elif command == 0x1A31:
            self.table = struct.unpack("<HI", data)
            self.order = tuple(range(self.table[0]))
        elif command == 0x1A32:
            self.table = struct.unpack_from("<HI", data)
            self.order = struct.unpack_from(f"<{self.table[0]}H", data, 6)
        elif command == 0x1A24:
            self.runs_from_ns, self.waits = None, False
            if data[0] == 2:
                self.waits = bool(self.order and self.entries[self.order[0]][5] & 0x80)
                if not self.waits:
                    self.runs_from_ns = self.clock.now_ns()
                    if self.wired is not None:
                        self.wired.trigger()
        elif command in (0x1A2A, 0x1A2C):
            self._loads[command] = int.from_bytes(data[:2], "little")
            self.pictures[self._loads[command], command] = b""
        elif command - 1 in self._loads:
            assert int.from_bytes(data[:2], "little") == len(data) - 2
            self.pictures[self._loads[command - 1], command - 1] += data[2:]

    def _answer(self, command: int) -> bytes:
        if command == 0x1A0C:
            found = self.answers.get(command, b"\0")[0]
            return bytes([found | (2 if self.running else 0)])
        usual = {
            0x0100: bytes([self.code]),
            0x0101: b"pattern out of range\0",
            0x0205: bytes([1, 0, 2, 6] + [0] * 12),
            0x0206: bytes(33),
            0x1A0A: bytes([1]),
            0x1A1B: bytes([self.mode]),
            0x1A31: struct.pack("<HI", *self.table),
            0x1A42: (105).to_bytes(2, "little"),
        }
        return self.answers.get(command, usual.get(command, b""))


class ScriptedUsb(OneInterfaceUsb):
    """A USB with such devices on it."""

    interface_class, class_bytes = VirtualDmdBus.interface_class, VirtualDmdBus.class_bytes
    endpoints = VirtualDmdBus.endpoints

    def __init__(self, *dmds: ScriptedDmd) -> None:
        super().__init__()
        self.dmds = list(dmds)
        self.claimed: set[str] = set()

    def enumerate_devices(self) -> Iterator[Any]:
        return iter(self.dmds)

    def get_device_descriptor(self, dev: Any) -> Any:
        place = 5 + self.dmds.index(dev), dev.port
        return make_device_descriptor(
            (0x0451, 0xC900), place, usb_version=0x0110, version=1, speed=2
        )

    def open_device(self, dev: ScriptedDmd) -> ScriptedDmd:
        if dev.open_error is not None and dev.open_error.errno == errno.EACCES:
            raise dev.open_error
        return dev

    def close_device(self, dev_handle: ScriptedDmd) -> None:
        self.claimed.discard(dev_handle.serial)

    def claim_interface(self, dev_handle: ScriptedDmd, _intf: int) -> None:
        if dev_handle.open_error is not None:
            raise dev_handle.open_error
        if dev_handle.kernel:
            raise usb.core.USBError("busy", -6, errno.EBUSY)
        self.claimed.add(dev_handle.serial)

    def release_interface(self, dev_handle: ScriptedDmd, _intf: int) -> None:
        self.claimed.discard(dev_handle.serial)

    def is_kernel_driver_active(self, dev_handle: ScriptedDmd, _intf: int) -> bool:
        return dev_handle.kernel

    def detach_kernel_driver(self, dev_handle: ScriptedDmd, _intf: int) -> None:
        dev_handle.kernel = False

    def attach_kernel_driver(self, dev_handle: ScriptedDmd, _intf: int) -> None:
        dev_handle.kernel = True

    def intr_write(self, dev_handle: ScriptedDmd, ep: int, _intf: int, data: Any, _ms: int) -> int:
        assert ep == 0x01
        dev_handle.take(bytes(data))
        return len(data)

    def intr_read(self, dev_handle: ScriptedDmd, ep: int, _intf: int, buff: Any, ms: int) -> int:
        assert ep == 0x81
        try:
            reply = dev_handle.give()
        except usb.core.USBTimeoutError:
            clock = dev_handle.clock
            clock.sleep_until_ns(clock.now_ns() + 1_000_000 * ms)
            raise
        memoryview(buff).cast("B")[: len(reply)] = reply
        return len(reply)

    def ctrl_transfer(
        self, dev_handle: ScriptedDmd, _kind: int, _request: int, value: int, _index: int,
        data: Any, _ms: int,
    ) -> int:  # fmt: skip
        return copy_reply(make_string_descriptor(value & 0xFF, (dev_handle.serial,) * 3), data)


class Dlpc900Rig:
    """Two scripted devices and the driver that shows frames on them."""

    def __init__(self, *, clock: Clock | None = None, **options: Any) -> None:
        self.clock = clock or VirtualClock()
        self.dmds = [ScriptedDmd(self.clock, name, (2, n)) for n, name in enumerate("AB", 1)]
        self.usb = ScriptedUsb(*self.dmds)
        self.options = {"projector": "A", "mask": "B", "usb": "scripted", **options}
        self.cancelled = False

    def config(self, **display: Any) -> Config:
        panel = PanelConfig(size_px=SIZE, refresh_hz=1e6 / ROW_US)
        return Config(
            projector=panel,
            mask=panel,
            display=DisplayConfig(driver="dlpc900", options=self.options, **display),
        )

    def make(self, config: Config | None = None) -> Dlpc900Display:
        context = DriverContext(
            config or self.config(),
            self.clock,
            SharedState(usb_backend=self.usb),
            cancelled=lambda: self.cancelled,
        )
        return Dlpc900Display.create(context)

    def forget(self) -> None:
        for dmd in self.dmds:
            dmd.sent.clear()


GRID = (6, 8)


def never() -> bool:
    return False


def ignore(*_: int) -> None:
    pass


def random_codes(count: int, seed: int = 1, passes: int = 1) -> Frames:
    rng = np.random.default_rng(seed)
    pairs = tuple(pack_bits(rng.random((count, GRID[0] * GRID[1])) < 0.5) for _ in range(2))
    return build_frames((pairs[0], pairs[1]), GRID, window="whole", schedule="none", passes=passes)


def opened(**options: Any) -> tuple[Dlpc900Rig, Dlpc900Display]:
    rig = Dlpc900Rig(**options)
    display = rig.make()
    display.connect()
    return rig, display


def shown(dmd: ScriptedDmd) -> list[tuple[Any, int, int]]:
    """Each entry in the device's order: its plane, exposure and dark time."""
    found = []
    for number in dmd.order:
        entry = dmd.entries[number]
        times = int.from_bytes(entry[2:5], "little"), int.from_bytes(entry[6:9], "little")
        found.append((dmd.plane(*dmd.place_of(number)), *times))
    return found


def shows_once(dmd: ScriptedDmd) -> bool:
    """Whether its table is one that ends, not that of black."""
    return dmd.table[1] > 0


def looked_at(rig: Dlpc900Rig, at: list[Any]) -> Callable[[], bool]:
    """What asks whether it is cancelled: takes down the tables once both show them."""

    def look() -> bool:
        if not at and all(shows_once(dmd) for dmd in rig.dmds):
            at.extend(shown(dmd) for dmd in rig.dmds)
        return False

    return look
