"""One DMD behind a DLPC900: its planes, its table of entries, and its black.

Picture 0 holds only a plane without light, and is loaded before any other: an endless sequence of
that plane is black, whatever mirrors do between sequences, which no guide says. All other planes
lie 24 a picture.

By the guide, pictures must be sent anew as soon as the number of entries, or what one of them
shows, has changed. So the panel goes black by an order of entries that shows only the last entry of
the loaded table: pictures survive that, and configuring the table again brings it back. In the same
way tables that come around again and again, as those of a stream, lie in the device side by side
(`drivers.dlpc900.around`), and each is shown by an order of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from contextlib import suppress
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import Clock, ConfigError, DeviceLost, PdcdError, SyncError

from .around import BLACK_PLANE, TableEntry, TablesAround, join_tables
from .commands import (
    DMD_KINDS,
    NORMAL,
    ON_THE_FLY,
    PICTURE_PART_B,
    PICTURE_SLOTS,
    STANDBY,
    START,
    STOP,
    Command,
    Hardware,
    Main,
    pack_entry,
    pack_order,
    pack_table,
)
from .erle import encode_picture
from .link import DeviceLink
from .options import Dlpc900Options

PLANES = 24
_BLACK_US = 1000
"""Length of the single entry of black."""
_READY_S, _PAUSE_S = 3.0, 0.02
"""Longest time for a device to wake up, change its mode or start; pause until it is asked again."""
_USUAL_LEAST_US = 105
DrawWords = Callable[[Sequence[bytes]], NDArray[np.uint32]]
"""Draws the planes of these keys as the bits of words, (height, width)."""
_Device = TypeVar("_Device")


class DmdPanel:
    """A panel that `take_over` has made black. Raises what `DeviceLink` does."""

    def __init__(
        self, link: DeviceLink, options: Dlpc900Options, clock: Clock, size_px: tuple[int, int]
    ) -> None:
        """size_px : as configured, for devices that do not report their kind."""
        self.link, self.role, self.size_px = link, link.role, size_px
        self.kind, self.firmware = "DLPC900", ""
        self.least_us, self.most_entries = _USUAL_LEAST_US, 400
        self._rooms = _find_rooms(400)
        self._options, self._clock = options, clock
        self._halves: list[tuple[Command, Command]] = []
        self._table: list[bytes] = []
        self._pictures: list[tuple[bytes, ...]] = [()] * PICTURE_SLOTS
        self._packed: dict[int, list[bytes]] = {}
        self._around = TablesAround()
        self._takes_orders = True
        self._shown: list[tuple[int, int, bytes]] = []
        self._status = Hardware(0)
        self._is_black = False

    def take_over(self) -> None:
        """Identify the device, and make it black."""
        self._identify()
        link = self.link
        if self._main() & Main.PARKED:
            link.tell(Command.POWER, bytes([NORMAL]))
            self._wait_until(lambda: not self._main() & Main.PARKED, "stays parked")
        with suppress(DeviceLost):  # it may refuse that while it shows no patterns
            self._stop()
            link.tell(Command.IDLE, bytes([0]))
        link.tell(Command.MODE, bytes([ON_THE_FLY]))
        self._wait_until(
            lambda: link.ask(Command.MODE)[:1] == bytes([ON_THE_FLY]), "does not take patterns"
        )
        self._stop()
        self.least_us = int.from_bytes(link.ask(Command.LEAST_EXPOSURE)[:2], "little")
        self.least_us = self.least_us or _USUAL_LEAST_US
        link.tell(Command.TRIGGER_OUT_1, bytes(5))  # not inverted, edges where an exposure has them
        self.set_trigger_delay(self.least_us)
        self._pack_picture(0, (BLACK_PLANE,), np.zeros(self.size_px[::-1], dtype=np.uint32))
        self._program(self._black_entries, 0)
        self._start()

    def set_trigger_delay(self, delay_us: int) -> None:
        """Let an edge on TRIG_IN_1 act later by `delay_us`, at least `least_us`."""
        falling = self._options.edge == "falling"
        self.link.tell(Command.TRIGGER_IN_1, delay_us.to_bytes(2, "little") + bytes([falling]))

    def load(self, table: Sequence[TableEntry], planes: Sequence[bytes], draw: DrawWords) -> int:
        """Take over planes and a table of them, then go black; returns the number of pictures that
        were drawn.

        planes : different keys of planes with light, `most_planes` at most. table : of these
        planes, ending with black.
        """
        around = self._around.find_round(table)
        if self._around.find(table) is not None:
            self.black()
            return 0
        plan = self._place(planes)
        for number, keys in plan.items():
            self._pack_picture(number, keys, draw(keys))
        self._is_black = False
        self._stop()
        joined = join_tables(around) if around and self._takes_orders else None
        if joined is not None and self._has_room(joined.entries):
            self._program(joined.entries, len(joined.entries), joined.waiting)
            self._around.hold(joined)
        else:
            self._program(table, len(table))
        self.black()
        return len(plan)

    def start(
        self, table: Sequence[TableEntry], *, shown: int | None, delay_us: int | None = None
    ) -> None:
        """Show a table of loaded planes: `shown` entries of it in all (None: over and over).

        delay_us : the sequence is black until an edge on TRIG_IN_1, and begins this long after it.
        None begins at once.
        """
        waits = delay_us is not None
        self._is_black = False
        self._stop()
        if delay_us is not None:  # not while a sequence runs
            self.set_trigger_delay(delay_us)
        order = self._around.find(table, waits=waits)
        if order is None or not self._take_order(order, shown or 0):
            self._program(table, shown or 0, (0,) if waits else ())
        self._status = self._hardware()
        self._start()
        if waits or shown is None:
            self._wait_to_run()

    def stop(self) -> None:
        """End its sequence, which keeps its trigger output still; for panels that show black."""
        self._is_black = False
        self._stop()

    def is_running(self) -> bool:
        """Whether a sequence is shown, or waits for its trigger."""
        return bool(self._main() & Main.RUNNING)

    def check_sequence(self) -> None:
        """Raise SyncError if the device says that the last sequence went wrong."""
        bad = self._hardware() & ~self._status & (Hardware.ABORTED | Hardware.SEQUENCE_FAULT)
        if bad:
            raise SyncError(
                f"gave up its sequence ({bad.name})",
                device=self.role,
                hint="keep its trigger lines still, and take longer rows or dark times",
            )

    def black(self) -> None:
        """Show the plane without light, for ever, from any state; or check that it is still
        shown."""
        if self._is_black:
            if self.is_running():
                return
            self._table, self._shown = [], []  # something else has changed its state
            self._around.part()
        if not self._show_last():
            self.start(self._black_entries, shown=None)
        self._is_black = True

    def close(self) -> None:
        """Leave it as the options say, and release it; a lost device is only released."""
        try:
            self.black()
            if self._options.rest != "black":
                self._is_black = False
                self._stop()
                command = Command.POWER if self._options.rest == "standby" else Command.IDLE
                self.link.tell(command, bytes([STANDBY]))
        finally:
            self.link.close()

    @property
    def most_planes(self) -> int:
        """Number of planes that can be loaded, besides black."""
        return sum(self._rooms[1:])

    @property
    def _black_entries(self) -> list[TableEntry]:
        return [TableEntry(BLACK_PLANE, max(_BLACK_US, self.least_us))]

    def _identify(self) -> None:
        """Find out its kind and state; raises DeviceLost if it is not fit to work, ConfigError if
        its size is not the configured one."""
        faults = Hardware.INCOMPATIBLE | Hardware.RESET_FAULT | Hardware.FORCED_SWAP
        status = require_healthy(self.link, faults, ", update its firmware")
        self._halves = [(Command.PICTURE_BEGIN, Command.PICTURE_DATA)]
        if status & Hardware.SECONDARY:
            self._halves.append((Command.SECOND_BEGIN, Command.SECOND_DATA))
        self.firmware = read_firmware(self.link)
        told = self.link.try_ask(Command.KIND) or b"\0"
        if told[0] not in DMD_KINDS:
            return
        self.kind, size_px, self.most_entries, planes = DMD_KINDS[told[0]]
        self._rooms = _find_rooms(planes)
        if size_px != self.size_px:
            (width, height), table = size_px, self.role
            raise ConfigError(
                f"is a {self.kind} of {width} x {height} mirrors, and {table}.size_px says "
                f"{self.size_px[0]} x {self.size_px[1]}",
                device=self.role,
                hint=f"set {table}.size_px = [{width}, {height}]",
            )

    def _show_last(self) -> bool:
        """Show the last entry over and over, if it is black and the device accepts an order of
        entries; returns whether it is shown."""
        if not self._shown or self._shown[-1][2] != BLACK_PLANE:
            return False
        self._is_black = False
        self._stop()
        if not self._take_order([len(self._shown) - 1], 0):
            return False
        self._start()
        self._wait_to_run()
        return True

    def _take_order(self, order: Sequence[int], shown: int) -> bool:
        """Have it show entries in this order; False if it accepts no order, like old firmware."""
        try:
            self.link.tell(Command.ORDER, pack_order(order, shown))
        except PdcdError:
            if self.link.lost:
                raise
            self._takes_orders = False
            return False
        return True

    def _has_room(self, entries: Sequence[TableEntry]) -> bool:
        """Whether a table is short enough, and all its planes are there."""
        held = {key for picture in self._pictures for key in picture}
        return len(entries) <= self.most_entries and held.issuperset(one.plane for one in entries)

    def _place(self, planes: Sequence[bytes]) -> dict[int, tuple[bytes, ...]]:
        """Find places for planes that have none yet; returns the pictures to draw, by number."""
        there = {key for held in self._pictures for key in held}
        missing = [key for key in planes if key not in there]
        rooms, wanted = self._rooms, set(planes)
        free = [n for n in range(1, len(rooms)) if wanted.isdisjoint(self._pictures[n])]
        free.sort(key=lambda number: bool(self._pictures[number]))  # empty ones first
        if sum(rooms[n] for n in free) < len(missing):  # wanted planes are too scattered
            missing, free = list(planes), list(range(1, len(rooms)))
            self._pictures[1:] = [()] * (PICTURE_SLOTS - 1)
        plan = {}
        for number in free:
            if missing:
                plan[number], missing = tuple(missing[: rooms[number]]), missing[rooms[number] :]
        return plan

    def _program(
        self, table: Sequence[TableEntry], shown: int, waiting: Container[int] = ()
    ) -> None:
        """Send the entries of a table that the device does not have yet, make the table valid, and
        send its pictures if it shows others than before. waiting : entries that wait for TRIG_IN_1.
        """
        self._around.part()
        places = {key: (n, bit) for n, held in enumerate(self._pictures)
                  for bit, key in enumerate(held)}  # fmt: skip
        led, pulse = self._options.led, self._options.trigger_bit
        packed = [
            pack_entry(
                n,
                (one.exposure_us, one.dark_us),
                places[one.plane],
                # Black is quiet, so that pulses can be counted while the shutter is open.
                (int(n in waiting), led, 1 - pulse if one.plane == BLACK_PLANE else pulse),
            )
            for n, one in enumerate(table)
        ]
        shows = [(*places[one.plane], one.plane) for one in table]
        had, self._table = self._table, []  # unknown until the device has taken all of it
        showed, self._shown = self._shown, []
        try:
            self._send_table(packed, had, shown)
        except ConfigError:
            if not had:
                raise
            had, showed = [], []
            self._send_table(packed, had, shown)  # it may have lost its entries
        if shows != showed:
            for number in sorted({picture for picture, _, _ in shows}, reverse=True):
                self._upload(number)  # the last one first, as in the guide
        self._table, self._shown = [*packed, *had[len(packed) :]], shows

    def _send_table(self, packed: list[bytes], had: list[bytes], shown: int) -> None:
        for number, entry in enumerate(packed):
            if number >= len(had) or had[number] != entry:
                self.link.tell(Command.ENTRY, entry)
        self.link.tell(Command.TABLE, pack_table(len(packed), shown))
        told = self.link.try_ask(Command.TABLE)
        found = int.from_bytes(told[:2], "little") if told else len(packed)
        if found != len(packed):
            raise ConfigError(
                f"took {found} of {len(packed)} entries", device=self.role, hint="take fewer codes"
            )

    def _pack_picture(
        self, number: int, keys: tuple[bytes, ...], words: NDArray[np.uint32]
    ) -> None:
        """Encode a picture for sending, one half for each controller. keys : of its planes."""
        options = self._options
        self._packed[number] = [
            encode_picture(half, options.plane_order, options.copy_above)
            for half in np.split(words, len(self._halves), axis=1)
        ]
        self._pictures[number] = keys

    def _upload(self, number: int) -> None:
        """Send a picture."""
        for (begin, data), packed in zip(self._halves, self._packed[number], strict=True):
            size = len(packed).to_bytes(4, "little")
            self.link.tell(begin, number.to_bytes(2, "little") + size)
            for at in range(0, len(packed), PICTURE_PART_B):
                part = packed[at : at + PICTURE_PART_B]
                self.link.pour(data, len(part).to_bytes(2, "little") + part)
            self.link.check_errors(data)

    def _stop(self) -> None:
        self.link.tell(Command.RUN, bytes([STOP]))

    def _start(self) -> None:
        self.link.tell(Command.RUN, bytes([START]))

    def _main(self) -> Main:
        return Main(self.link.ask(Command.MAIN)[0])

    def _hardware(self) -> Hardware:
        return Hardware(self.link.ask(Command.HARDWARE)[0])

    def _wait_to_run(self) -> None:
        self._wait_until(self.is_running, "does not start its sequence")

    def _wait_until(self, done: Callable[[], bool], what: str) -> None:
        """Wait without `Patience`: each panel is loaded by a thread of its own, which does not
        check for a cancel itself; the link's `look` ends its work."""
        until_ns = self._clock.now_ns() + round(_READY_S * 1e9)
        while not done():
            if self._clock.now_ns() >= until_ns:
                raise DeviceLost(what, device=self.role, hint="switch it off and on")
            self._clock.sleep_until_ns(self._clock.now_ns() + round(_PAUSE_S * 1e9))


def require_healthy(link: DeviceLink, faults: Hardware, remedy: str = "") -> Hardware:
    """Status of a controller, a DLPC900 or a DLPC350. Raises DeviceLost if it is not fit to work.
    faults : those that its status can report. remedy : what else may help."""
    status = Hardware(link.ask(Command.HARDWARE)[0])
    wrong = status & faults
    if wrong or not status & Hardware.READY:
        raise DeviceLost(
            f"is not fit to work: {wrong.name or 'not initialised'} (status {int(status):#04x})",
            device=link.role,
            hint=f"check the cable to its mirrors, switch it off and on{remedy}",
        )
    return status


def read_firmware(link: DeviceLink) -> str:
    """Firmware version of one of these controllers; "" if it does not report it."""
    version = link.try_ask(Command.VERSION) or b""
    if len(version) < 4:
        return ""
    return f"{version[3]}.{version[2]}.{int.from_bytes(version[:2], 'little')}"


def apply_to_each(devices: Sequence[_Device], work: Callable[[_Device], None]) -> None:
    """Do some work on each device, even if it fails on another; then raise the first error."""
    errors = []
    for device in devices:
        try:
            work(device)
        except PdcdError as err:
            errors.append(err)
    if errors:
        raise errors[0]


def _find_rooms(planes: int) -> list[int]:
    """How many planes each picture may hold, in a device with memory for `planes` planes."""
    return [min(PLANES, planes - first) for first in range(0, planes, PLANES)][:PICTURE_SLOTS]
