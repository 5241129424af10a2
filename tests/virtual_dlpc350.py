"""A DLPC350 (LightCrafter 4500) that is not there, as seen over USB, down to the bytes.

It lives on a `VirtualDmdBus`, takes commands in the same reports as the DLPC900, and shows the
planes of a video signal that a test feeds (`connect_video`, `drive_video`).

Modelled: framing and replies; power; video and pattern mode; the mailbox with its LUT, times, their
validation; sequences that begin with a picture. A command that is not allowed, or not known, gets a
reply with its error bit: this controller has no codes for why.

Not modelled: patterns of several bits, flash, other triggers than VSYNC, times of each pattern,
LEDs, levels of plain video, flips, the inputs and which of them has the signal.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.virtual_dlpc900.model import VirtualDmdFault
from drivers.virtual_dlpc900.plug import ReportController
from drivers.virtual_dlpc900.reports import TakenCommand
from drivers.virtual_dlpc900.sequencer import PlayedContent, PlayedPlane
from pdcd.driver import Clock

MIRRORS_PX = (912, 1140)
_PLANES, _LUT_ENTRIES = 24, 128
_BLACK_US = 230
"""What the guide has for a black pattern, and for any time beside the exposure."""
_BOOT_NS = 3_000_000_000
_KEPT = 4096
"""Changes of what it shows that can be asked for later."""
_OUT_OF_RANGE, _BAD_PATTERN, _OVERLAP, _NO_BLACK, _TOO_CLOSE, _BUSY = 1, 2, 4, 8, 16, 128
"""Bits of a validation; the first two let nothing start."""
_CONTINUES = 3
_SHIFTS = {"R": 16, "G": 8, "B": 0}


@dataclass(frozen=True)
class VirtualDlpc350Options:
    """What a client cannot know beforehand.

    after_stop : what stands once a sequence was stopped: nothing, or the pattern that was there.
    overrun : what a picture does that comes before the last one's patterns are over: end the
        sequence, or pass unseen.
    lock_told : where the lock of a signal is read: 0x071C, or bit 3 of 0x1A0C, which else says
        whether gamma is corrected, and is set. A unit of the second kind does not know 0x071C.
    video_planes : colours that hold planes 0-7, 8-15 and 16-23 of a picture.
    vsync_type : trigger type of an entry that a picture begins; another one waits for ever.
    starts : how many starts it takes after a change of mode.
    least_exposure_us : of a plane; shorter ones fail their validation.
    warns : bits that each validation finds beside what is wrong.
    validate_s, mode_s, wake_s : how long a validation, a change of mode, and waking up take.
    report_s : time that one report takes.
    """

    after_stop: Literal["black", "holds"] = "black"
    overrun: Literal["stops", "misses"] = "stops"
    lock_told: Literal["signal", "main"] = "signal"
    video_planes: Literal["GRB", "GBR", "RGB", "RBG", "BRG", "BGR"] = "GRB"
    vsync_type: Literal[1, 2] = 1
    starts: Literal[1, 2] = 2
    least_exposure_us: int = 235
    warns: int = 0
    validate_s: float = 0.05
    mode_s: float = 0.1
    wake_s: float = 1.0
    report_s: float = 0.001


class _RefusedError(Exception):
    """A command that is not done."""


class _Command(NamedTuple):
    """What is done with one command; `length` of its data, None for any."""

    write: Callable[[VirtualDlpc350, bytes], None] | None = None
    length: int | None = 1
    read: Callable[[VirtualDlpc350], bytes] | None = None


class VirtualDlpc350(ReportController):
    """One controller with its mirrors."""

    usb_ids, product = (0x0451, 0x6401), "DLPC350"

    def __init__(
        self,
        clock: Clock,
        serial: str,
        options: VirtualDlpc350Options | None = None,
        faults: Sequence[VirtualDmdFault] = (),
    ) -> None:
        self.options = options or VirtualDlpc350Options()
        super().__init__(clock, serial, self.options.report_s, faults)
        self.connected = False
        self._past: list[tuple[int, PlayedContent]] = [(-(2**62), None)]
        self._boot()

    def restart(self) -> None:
        """Switch it off and on: it is away for some seconds."""
        with self._lock:
            now_ns = self.clock.now_ns()
            self._leave_until(now_ns + _BOOT_NS)
            self._put(now_ns, None)
            self._forget_reports()
            self._boot()

    def _boot(self) -> None:
        self._standby, self._wakes_ns = False, 0
        self._mode, self._mode_ns, self._told_mode = 0, 0, 0
        self._source, self._trigger = 3, 0
        self._times_us, self._config = (0, 0), bytes(4)
        self._mailbox, self._offset = 0, 0
        self._lut = [bytes(3)] * _LUT_ENTRIES
        self._status, self._validated_ns = _BAD_PATTERN, 0
        self._valid = self._aborted = False
        self._run, self._starts, self._over_ns, self._place = 0, 0, 0, 0
        self._abort_after: int | None = None

    # The signal, and what is shown

    def connect_video(self, _refresh_hz: float) -> None:
        """A signal comes from now on; its pictures by `drive_video`."""
        self.connected = True

    def disconnect_video(self, _at_ns: int) -> None:
        """It is gone: what has begun goes on to its end."""
        self.connected = False

    def drive_video(self, words: NDArray[np.uint32], at_ns: int) -> None:
        """A picture of the signal begins, (1140, 912) of 0xRRGGBB. Raises ValueError for one of
        another size: it would be scaled, and no plane be what it was."""
        if words.shape != MIRRORS_PX[::-1]:
            raise ValueError(f"a picture of {words.shape} for mirrors of {MIRRORS_PX}")
        with self._lock:
            if not self.connected or self._parked_at(at_ns):
                return
            if self._mode_at(at_ns) == 0:
                lit = (words & 0xFFFFFF != 0).astype(np.uint32)
                self._put(at_ns, PlayedPlane(lit, 0) if lit.any() else None)
            elif self._run == 2 and not self._source and not self._trigger:
                self._begin_picture(words, at_ns)

    def list_changes(self, low_ns: int, high_ns: int) -> list[tuple[int, PlayedContent]]:
        """What its mirrors showed from `low_ns` on, and each change before `high_ns`."""
        with self._lock:
            before = [content for at_ns, content in self._past if at_ns <= low_ns]
            after = [one for one in self._past if low_ns < one[0] < high_ns]
            return [(low_ns, before[-1]), *after]

    def find_content(self) -> PlayedContent:
        """What they show now."""
        now_ns = self.clock.now_ns()
        return self.list_changes(now_ns, now_ns + 1)[-1][1]

    def _begin_picture(self, words: NDArray[np.uint32], at_ns: int) -> None:
        if at_ns < self._over_ns:
            if self.options.overrun == "stops":
                self._stop(at_ns)
                self._aborted = True
            return
        entries = self._lut[: 1 + self._config[0]]
        if entries[self._place][0] & 3 != self.options.vsync_type:
            return
        exposure_us, period_us = self._times_us
        first, left = True, self._abort_after
        while first or (self._place and entries[self._place][0] & 3 in (0, _CONTINUES)):
            first = False
            if left == 0:
                self._stop(at_ns)
                self._aborted = True
                return
            left = None if left is None else left - 1
            self._put(at_ns, self._find_plane(entries[self._place], words))
            if entries[self._place][2] & 2:
                self._put(at_ns + 1000 * exposure_us, None)
            at_ns += 1000 * period_us
            self._place = (self._place + 1) % len(entries)
        # Black after the last one's whole period has to be over as well.
        black = entries[self._place - 1][2] & 2 and exposure_us == period_us
        self._over_ns = at_ns + (1000 * _BLACK_US if black else 0)
        if not self._place and not self._config[1]:
            self._run = 0

    def _find_plane(self, entry: bytes, words: NDArray[np.uint32]) -> PlayedPlane:
        number = entry[0] >> 2
        bit = _SHIFTS[self.options.video_planes[number // 8]] + number % 8
        return PlayedPlane(~words if entry[2] & 1 else words, bit)

    def _put(self, at_ns: int, content: PlayedContent) -> None:
        """What comes now takes the place of what was still to come."""
        while self._past[-1][0] >= at_ns:
            self._past.pop()
        self._past.append((at_ns, content))
        del self._past[:-_KEPT]

    def _stop(self, at_ns: int) -> None:
        if self._mode_at(at_ns) == 1:
            content = self.list_changes(at_ns, at_ns + 1)[-1][1]
            self._put(at_ns, content if self.options.after_stop == "holds" else None)
        self._run, self._place, self._over_ns = 0, 0, 0

    def _parked_at(self, at_ns: int) -> bool:
        return self._standby or at_ns < self._wakes_ns

    def _mode_at(self, at_ns: int) -> int:
        if at_ns >= self._mode_ns:
            self._told_mode = self._mode
        return self._told_mode

    # Commands

    def _answer(self, command: TakenCommand, fault: VirtualDmdFault | None) -> bytes:
        kind = None if fault is None else fault.kind
        try:
            if kind == "error":
                raise _RefusedError
            if not command.reads:
                aborts = fault is not None and kind == "abort"
                self._abort_after = fault.patterns if fault is not None and aborts else None
            return command.answer(self._do(command))
        except _RefusedError:
            return command.answer(failed=True)

    def _do(self, command: TakenCommand) -> bytes:
        found, data = self._commands.get(command.code), command.data
        if found is None or command.for_others:
            raise _RefusedError
        if command.reads:
            if found.read is None:
                raise _RefusedError
            return found.read(self)
        if found.write is None or command.too_long or found.length not in (None, len(data)):
            raise _RefusedError
        found.write(self, data)
        return b""

    def _set_power(self, data: bytes) -> None:
        now_ns = self.clock.now_ns()
        _require(data[0] <= 1)
        if data[0] and not self._standby:
            self._stop(now_ns)
            self._put(now_ns, None)
        elif self._standby and not data[0]:
            self._wakes_ns = now_ns + round(1e9 * self.options.wake_s)
        self._standby = bool(data[0])

    def _set_mode(self, data: bytes) -> None:
        now_ns = self.clock.now_ns()
        _require(data[0] <= 1 and not self._run and not self._parked_at(now_ns))
        if data[0] != self._mode:
            self._mode_at(now_ns)
            self._mode, self._starts = data[0], 0
            self._mode_ns = now_ns + round(1e9 * self.options.mode_s)

    def _start_or_stop(self, data: bytes) -> None:
        now_ns = self.clock.now_ns()
        _require(data[0] <= 2)
        if not data[0]:
            return self._stop(now_ns)
        ready = self._valid and now_ns >= self._validated_ns
        _require(ready and self._mode_at(now_ns) == 1 and not self._parked_at(now_ns))
        self._starts += 1
        if data[0] == 2 and self._starts < self.options.starts:
            return  # swallowed, as the first one after a change of mode
        self._run, self._aborted = data[0], False

    def _configure(self, name: str, value: object) -> None:
        """Set what is to be validated before the next start."""
        _require(not self._run)
        setattr(self, name, value)
        self._valid = False

    def _set_source(self, data: bytes) -> None:
        _require(data[0] in (0, 3))
        self._configure("_source", data[0])

    def _set_trigger(self, data: bytes) -> None:
        _require(data[0] <= 4)
        self._configure("_trigger", data[0])

    def _set_config(self, data: bytes) -> None:
        _require(data[0] < _LUT_ENTRIES and data[1] <= 1 and data[3] < 64)
        self._configure("_config", data)

    def _open_mailbox(self, data: bytes) -> None:
        _require(data[0] <= 3)
        self._configure("_mailbox", data[0])

    def _set_offset(self, data: bytes) -> None:
        _require(self._mailbox and data[0] < _LUT_ENTRIES)
        self._offset = data[0]

    def _fill_mailbox(self, data: bytes) -> None:
        count, rest = divmod(len(data), 3)
        _require(self._mailbox == 2 and count and not rest)
        _require(self._offset + count <= _LUT_ENTRIES)
        lut = list(self._lut)
        for number in range(count):
            lut[self._offset + number] = data[3 * number : 3 * number + 3]
        self._configure("_lut", lut)

    def _validate(self, _data: bytes) -> None:
        _require(not self._run and not self._mailbox)
        entries = self._lut[: 1 + self._config[0]]
        exposure_us, period_us = self._times_us
        status = self.options.warns
        if not self.options.least_exposure_us <= exposure_us <= period_us:
            status |= _OUT_OF_RANGE
        elif 0 < period_us - exposure_us < _BLACK_US:
            status |= _TOO_CLOSE
        for n, (what, depth, how) in enumerate(entries):
            if depth & 15 != 1 or what >> 2 >= _PLANES:
                status |= _BAD_PATTERN
            if how & 8 and (how & 2 or entries[n - 1][2] & 2):
                status |= _OVERLAP
            if what & 3 in (1, 2) and not entries[n - 1][2] & 2:
                status |= _NO_BLACK
        self._status = status
        self._valid = not status & (_OUT_OF_RANGE | _BAD_PATTERN)
        self._validated_ns = self.clock.now_ns() + round(1e9 * self.options.validate_s)

    def _read_validation(self) -> bytes:
        busy = self.clock.now_ns() < self._validated_ns
        return bytes([_BUSY if busy else self._status])

    def _read_signal(self) -> bytes:
        _require(self.options.lock_told == "signal")
        return bytes([2 if self.connected else 0]).ljust(28, b"\0")

    def _read_hardware(self) -> bytes:
        return bytes([1 | self._aborted << 6 | self._aborted << 7])

    def _read_main(self) -> bytes:
        parked = self._parked_at(self.clock.now_ns())
        third = self.connected if self.options.lock_told == "main" else True
        return bytes([parked | (self._run == 2) << 1 | third << 3])

    _commands: ClassVar[dict[int, _Command]] = {
        0x0200: _Command(_set_power, 1, lambda self: bytes([self._standby])),
        0x0205: _Command(read=lambda _: struct.pack("<HBB", 1, 2, 4) * 4),
        0x071C: _Command(read=_read_signal),
        0x1A0A: _Command(read=_read_hardware),
        0x1A0B: _Command(read=lambda _: b"\1"),
        0x1A0C: _Command(read=_read_main),
        0x1A1A: _Command(_validate, 1, _read_validation),
        0x1A1B: _Command(_set_mode, 1, lambda self: bytes([self._mode_at(self.clock.now_ns())])),
        0x1A22: _Command(_set_source, 1, lambda self: bytes([self._source])),
        0x1A23: _Command(_set_trigger, 1, lambda self: bytes([self._trigger])),
        0x1A24: _Command(_start_or_stop, 1, lambda self: bytes([self._run])),
        0x1A29: _Command(
            lambda self, data: self._configure("_times_us", struct.unpack("<II", data)),
            8,
            lambda self: struct.pack("<II", *self._times_us),
        ),
        0x1A31: _Command(_set_config, 4, lambda self: self._config),
        0x1A32: _Command(_set_offset, 1, lambda self: bytes([self._offset])),
        0x1A33: _Command(_open_mailbox, 1, lambda self: bytes([self._mailbox])),
        0x1A34: _Command(_fill_mailbox, None),
    }


def _require(allowed: object) -> None:
    """Refuse a command that is not allowed."""
    if not allowed:
        raise _RefusedError
