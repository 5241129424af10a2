"""A DLPC350 (LightCrafter 4500) that shows the bits of a video signal.

It takes the reports of a DLPC900 and has most of its states, but no pictures of its own, no error
codes, and one exposure for all patterns. Its table goes through a mailbox, and is validated before
it may be started. Without a signal it can always be made black: by stopping and parking its
mirrors.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

from pdcd.driver import ConfigError, DeviceLost, Patience

from .commands import NORMAL, STANDBY, START, STOP, Hardware, Main
from .device import read_firmware, require_healthy
from .link import DeviceLink
from .video import (
    LOCK_S,
    READY_S,
    SIGNAL_HINT,
    PlaneTimes,
    VideoDmd,
    VideoEntry,
    wait_until,
)

_MIRRORS_PX = (912, 1140)
_LEAST_US, _BLACK_US = 235, 230
"""The shortest exposure of a plane, and the time of a black pattern, by TI's guide."""
_WAKE_S, _CHANGE_S = 10.0, 0.1
_PATTERNS, _OF_VIDEO, _BY_VSYNC, _REPEAT = 1, 0, 0, 1
_CLOSED, _TABLE = 0, 2
"""Mailboxes."""
_ONE_BIT, _CONTINUES, _INSERT_BLACK = 1, 3, 2
_BUSY = 0x80


class _Command(enum.IntEnum):
    """The commands that are used."""

    POWER = 0x0200
    SIGNAL = 0x071C
    MAIN = 0x1A0C
    VALIDATE = 0x1A1A
    SOURCE = 0x1A22
    TRIGGER = 0x1A23
    RUN = 0x1A24
    TIMES = 0x1A29
    TABLE = 0x1A31
    MAILBOX_OFFSET = 0x1A32
    MAILBOX = 0x1A33
    MAILBOX_DATA = 0x1A34


class _Wrong(enum.IntFlag):
    """The faults that a validation can find."""

    EXPOSURE_OR_PERIOD = 1
    PATTERN_NUMBER = 2
    TRIGGER_OUT_OVER_BLACK = 4
    BLACK_MISSING = 8
    DARK_TOO_SHORT = 16


class Dlpc350Ways(NamedTuple):
    """Choices that the guide leaves open, and LEDs as bits (`DlpcVideoOptions`)."""

    led: int
    first_trigger: int
    lock_from: Literal["signal", "main"]


class Dlpc350Panel:
    """The device without a signal: its mirrors are parked. Raises what `DeviceLink` does."""

    kind, least_us = "DLPC350", _LEAST_US

    def __init__(
        self, link: DeviceLink, rest: str, size_px: tuple[int, int], patience: Patience
    ) -> None:
        """rest, size_px : as configured."""
        self.link, self.role, self.firmware = link, link.role, ""
        self._rest, self._size_px, self._patience = rest, size_px, patience

    def take_over(self) -> None:
        """Make it black, and identify it."""
        link = self.link
        unanswered = _stop(link)
        link.tell(_Command.POWER, bytes([STANDBY]))
        hint = "switch it off, or cover it: it may be lit"
        over = DeviceLost("does not park its mirrors", device=self.role, hint=hint)
        wait_until(self._patience, lambda: bool(_read_main(link) & Main.PARKED), READY_S, over)
        if unanswered is not None:
            raise unanswered
        self._identify()

    def close(self) -> None:
        """Release it, as dark as it is."""
        self.link.close()

    def _identify(self) -> None:
        """Raise DeviceLost if it is not fit to work, ConfigError for options it does not have."""
        require_healthy(self.link, Hardware.RESET_FAULT | Hardware.FORCED_SWAP)
        self.firmware = read_firmware(self.link)
        if self._size_px != _MIRRORS_PX:
            raise ConfigError(
                "is a DLPC350 of {} x {} mirrors, and {}.size_px says {} x {}".format(
                    *_MIRRORS_PX, self.role, *self._size_px
                ),
                device=self.role,
                hint=f"set {self.role}.size_px = {list(_MIRRORS_PX)}, which is the mode as well",
            )
        if self._rest == "idle":
            raise ConfigError(
                "cannot let its mirrors toggle", device=self.role, hint='set dlpc.rest = "black"'
            )


class Dlpc350Dmd(VideoDmd):
    """A LightCrafter 4500 that shows bits once `follow` has returned, and is parked before."""

    black_us, least_dark_us, mode = _BLACK_US, _BLACK_US, _PATTERNS

    def __init__(
        self,
        link: DeviceLink,
        make_panel: Callable[[], Dlpc350Panel],
        ways: Dlpc350Ways,
        patience: Patience,
    ) -> None:
        super().__init__(link, make_panel, (ways.led, 0, 0), patience)
        self._ways = ways

    def make_wedge(self, longest: PlaneTimes) -> list[VideoEntry]:
        """Entries that never light the first eight planes, light the next eight once, and the last
        eight twice, as all have one exposure."""
        bits = [*range(8, 16), *(bit for bit in range(16, 24) for _ in range(2))]
        return [VideoEntry(bit, longest) for bit in bits]

    def _set_up(self, entries: Sequence[VideoEntry]) -> None:
        link = self.link
        if (unanswered := _stop(link)) is not None:
            raise unanswered
        self._tell(_Command.POWER, NORMAL)
        awake = lambda: not self._has(Main.PARKED)  # noqa: E731
        self._wait_until(awake, _WAKE_S, "stays parked", "switch it off and on")
        self._wait_until(self._is_locked, LOCK_S, "finds no video signal", SIGNAL_HINT)
        self._enter_mode(_CHANGE_S, "does not take patterns", "switch it off and on")
        self._tell(_Command.SOURCE, _OF_VIDEO)
        self._tell(_Command.TRIGGER, _BY_VSYNC)
        last = len(entries) - 1
        link.tell(_Command.TABLE, bytes([last, _REPEAT, last, 0]))
        times = entries[0].times
        link.tell(_Command.TIMES, struct.pack("<II", times.exposure_us, times.plane_us))
        self._tell(_Command.MAILBOX, _TABLE)
        for n, (bit, _) in enumerate(entries):
            self._tell(_Command.MAILBOX_OFFSET, n)
            link.tell(_Command.MAILBOX_DATA, self._pack_entry(bit, times, n == 0, n == last))
        self._tell(_Command.MAILBOX, _CLOSED)
        self._validate()
        self._status = self._read_hardware()
        for _ in range(2):  # the first one after video mode does nothing
            self._tell(_Command.RUN, START)
        self._wait_until(
            lambda: self._has(Main.RUNNING), READY_S, "does not start its planes", SIGNAL_HINT
        )

    def _pack_entry(self, bit: int, times: PlaneTimes, first: bool, last: bool) -> bytes:
        """A pattern of the mailbox, which waits for the picture or follows the previous one. It is
        black after it if its time is longer than its exposure, and before the next picture."""
        trigger = self._ways.first_trigger if first else _CONTINUES
        black = _INSERT_BLACK if last or times.dark_us else 0
        return bytes([trigger | bit << 2, _ONE_BIT | self._ways.led << 4, black])

    def _validate(self) -> None:
        """Check that the device accepts its table. Raises ConfigError."""
        found = _BUSY

        def is_done() -> bool:
            nonlocal found
            found = self.link.ask(_Command.VALIDATE)[0]
            return not found & _BUSY

        self._tell(_Command.VALIDATE, 0)
        hint = "switch it off and on"
        self._wait_until(is_done, READY_S, "does not end the validation of its table", hint)
        if found:
            wrong = (_Wrong(found).name or f"bits {found:#04x}").lower().replace("_", " ")
            raise ConfigError(
                f"does not take its table: {wrong.replace('|', ', ')}",
                device=self.role,
                hint="take a slower mode, or dlpc.dark_us = 0; update its firmware",
            )

    def _is_locked(self) -> bool:
        if self._ways.lock_from == "main":
            return self._has(Main.LOCKED)
        return self.link.ask(_Command.SIGNAL)[0] & 3 == 2


def _read_main(link: DeviceLink) -> Main:
    return Main(link.ask(_Command.MAIN)[0])


def _stop(link: DeviceLink) -> DeviceLost | None:
    """Stop its planes; returns the error if the link is lost. In video mode it may refuse."""
    try:
        link.tell(_Command.RUN, bytes([STOP]))
    except DeviceLost as err:
        return err if link.lost else None
    return None
