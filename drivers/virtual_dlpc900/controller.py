"""The virtual DLPC900: a state machine that takes reports and answers them as the controller does.

It has no connection of its own: `drivers.virtual_dlpc900.usb_bus` puts it on a pyusb backend, and a
stand-in for another library may call `write_report` and `read_report` itself. Its lines are driven
by `drive_line`; `sequencer` says what its mirrors showed.

Modelled: framing and replies; which commands are allowed when, in the order number, length, mode,
parameters; power, idle mirrors, resets; video, flash, video-pattern and on-the-fly mode; images to
one controller or two; the LUT, its configuration and reordering; triggers both ways. Its mirrors
have a power supply of their own: a sequence goes on when the plug is out.

Not modelled: patterns of several bits, LEDs, blocks, flips and inversion, levels of video, which
input has the signal, flash beyond one pattern, batch files, I2C, firmware updates, the settling of
mirrors (panels have rise and fall times for that).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import ClassVar, Literal, NamedTuple

from pdcd.driver import Clock

from .decode import DecodedWords
from .memory import PatternMemory
from .model import (
    VIRTUAL_USB_IDS,
    DmdRegister,
    RefusalCode,
    RefusedError,
    VirtualDmdFault,
    VirtualDmdModel,
    VirtualDmdOptions,
)
from .plug import ReportController
from .registers import REGISTER_LENGTHS, TRIGGER_REGISTERS, DmdRegisters
from .reports import TakenCommand
from .sequencer import DmdSequencer, PlayedContent, PlayedEntry, PlayedProgram
from .video import VideoInput

_VIDEO, _FLASH, _VIDEO_PATTERN, _ON_THE_FLY = range(4)
_NORMAL, _STANDBY, _RESET = range(3)
_STOP, _PAUSE, _START = range(3)
_BOOT_NS = 3_000_000_000
_LOCKING_NS = 300_000_000
"""Time from the command for video-pattern mode until the mode is on."""
_IDLE_US = 105
_TEXT_BYTES = 60
_VERSION = struct.pack("<HBB", 0, 0, 6) * 4
_TAG = b"virtual"


class _Command(NamedTuple):
    """How one command is handled. `length` is that of its data; None allows any."""

    write: Callable[[VirtualDlpc900, bytes], None] | None = None
    length: int | None = 1
    read: Callable[[VirtualDlpc900], bytes] | None = None


class VirtualDlpc900(ReportController):
    """One controller with its mirrors. Safe for several threads."""

    usb_ids, product = VIRTUAL_USB_IDS, "DLPC900"

    def __init__(
        self,
        clock: Clock,
        model: VirtualDmdModel,
        serial: str,
        options: VirtualDmdOptions | None = None,
        faults: Sequence[VirtualDmdFault] = (),
    ) -> None:
        self.options = options or VirtualDmdOptions()
        super().__init__(clock, serial, self.options.report_s, faults, self.options.replies_kept)
        self.model = model
        self.sequencer = DmdSequencer(self.options)
        self.memory = PatternMemory(model, self.options)
        self._locks_ns: int | None = None
        self._acked = False
        self._abort_after: int | None = None
        self._code = 0
        self._video = VideoInput(model, self.options, self.memory, self.sequencer)
        self._registers = DmdRegisters(model.least_exposure_us)
        self._boot(clock.now_ns())

    def restart(self) -> None:
        """Switch it off and on: it is away for some seconds, then starts from its flash."""
        with self._lock:
            now_ns = self.clock.now_ns()
            self._leave_until(now_ns + _BOOT_NS)
            self.sequencer.darken(now_ns)
            self._boot(now_ns + _BOOT_NS)

    def _boot(self, at_ns: int) -> None:
        self._forget_reports()
        self._mode, self._locks_ns = _FLASH, None
        self._power, self._idle = _NORMAL, False
        self._error, self._text = RefusalCode.NONE, bytearray(_TEXT_BYTES)
        self._registers.forget()
        self.memory.forget()
        if self.options.startup:
            shown = PlayedEntry(1_000_000, 0, False, False, False, 0, 0)
            self.sequencer.start(at_ns, PlayedProgram([shown], [0], [self.memory.startup], 0))

    def _answer(self, command: TakenCommand, fault: VirtualDmdFault | None) -> bytes:
        """Do a command, and return the outcome."""
        now_ns = self.clock.now_ns()
        self.sequencer.settle(now_ns)
        if self._locks_ns is not None and now_ns >= self._locks_ns:
            self._mode, self._locks_ns = _VIDEO_PATTERN, None
        asks = command.code in (DmdRegister.ERROR_CODE, DmdRegister.ERROR_TEXT)
        try:
            data = self._do(command, fault)
        except RefusedError as refusal:
            text = str(refusal).encode()[: _TEXT_BYTES - 1] + b"\0"
            self._text[: len(text)] = text
            self._error = refusal.code
            return command.answer(failed=True)
        if not asks:
            self._error = RefusalCode.NONE
        return command.answer(data)

    def _do(self, command: TakenCommand, fault: VirtualDmdFault | None) -> bytes:
        if fault is not None and fault.kind == "error":
            raise RefusedError(fault.code)
        found = self._commands.get(command.code)
        if found is None or command.for_others:
            raise RefusedError(RefusalCode.UNKNOWN_COMMAND, f"command {command.code:04x}")
        self._code = command.code
        if command.reads:
            if found.read is None:
                raise RefusedError(RefusalCode.UNKNOWN_COMMAND, f"{command.code:04x} is not read")
            return found.read(self)
        if found.write is None:
            raise RefusedError(RefusalCode.UNKNOWN_COMMAND, f"{command.code:04x} is not written")
        length = REGISTER_LENGTHS.get(command.code, found.length)
        if command.too_long or length not in (None, len(command.data)):
            raise RefusedError(RefusalCode.PARAMETER, f"{len(command.data)} bytes of data")
        self._acked = command.wants_reply
        aborts = fault is not None and fault.kind == "abort"
        self._abort_after = fault.patterns if fault is not None and aborts else None
        found.write(self, command.data)
        return b""

    # Power and modes

    def _set_power(self, data: bytes) -> None:
        if data[0] > _RESET:
            raise RefusedError(RefusalCode.PARAMETER)
        if data[0] == _RESET:
            return self.restart()
        if data[0] != self._power:
            self._power, self._idle = data[0], False
            self.sequencer.darken(self.clock.now_ns())

    def _set_idle(self, data: bytes) -> None:
        if data[0] > 1:
            raise RefusedError(RefusalCode.PARAMETER)
        now_ns = self.clock.now_ns()
        if self._idle:
            self.sequencer.darken(now_ns)
        self._idle = False
        self._require(stopped=True, powered=True)
        if data[0]:
            turn = PlayedEntry(_IDLE_US, 0, False, False, False, 0, 0)
            planes = [self.memory.white, None]
            self.sequencer.start(now_ns, PlayedProgram([turn, turn], [0, 1], planes, 0))
            self._idle = True

    def _set_mode(self, data: bytes) -> None:
        mode = data[0]
        if mode > _ON_THE_FLY:
            raise RefusedError(RefusalCode.PARAMETER)
        self._require(stopped=True, powered=True)
        if mode == self._mode:
            self._locks_ns = None
            return
        if mode == _VIDEO_PATTERN:
            if self._mode != _VIDEO or not self._video.locked:
                raise RefusedError(
                    RefusalCode.WRONG_MODE, "from video mode with a locked source only"
                )
            self._locks_ns = self.clock.now_ns() + _LOCKING_NS
        else:
            self._mode, self._locks_ns = mode, None
        self.memory.forget()

    def _require(self, *modes: int, stopped: bool = False, powered: bool = False) -> None:
        """Refuse a command that is not allowed now."""
        if powered and self._power != _NORMAL:
            raise RefusedError(RefusalCode.WRONG_MODE, "the mirrors are parked")
        if modes and self._mode not in modes:
            raise RefusedError(RefusalCode.WRONG_MODE, f"not in mode {self._mode}")
        if stopped and not self.sequencer.stopped:
            raise RefusedError(RefusalCode.WRONG_MODE, "stop the sequence first")

    def _run(self, data: bytes) -> None:
        now_ns = self.clock.now_ns()
        if data[0] > _START:
            raise RefusedError(RefusalCode.PARAMETER)
        if data[0] == _STOP:
            if not self._idle:
                self.sequencer.stop(now_ns)
            return
        self._require(_FLASH, _VIDEO_PATTERN, _ON_THE_FLY, powered=True)
        if self._idle:
            raise RefusedError(RefusalCode.WRONG_MODE, "the mirrors are idle")
        if data[0] == _PAUSE:
            return self.sequencer.pause(now_ns)
        if not self.memory.entries:
            raise RefusedError(RefusalCode.DEFINITION, "no entries are configured")
        if self._mode == _VIDEO_PATTERN and not self._video.locked:
            raise RefusedError(RefusalCode.WRONG_MODE, "there is no signal")
        self.sequencer.start(now_ns, self._make_program(), self._abort_after)

    def _make_program(self) -> PlayedProgram:
        if self._mode == _VIDEO_PATTERN:
            return self.memory.make_video_program(None)
        return self.memory.make_program()

    # The LUT

    def _define(self, data: bytes) -> None:
        self._require(_FLASH, _VIDEO_PATTERN, _ON_THE_FLY, stopped=True, powered=True)
        in_flash, of_video = self._mode == _FLASH, self._mode == _VIDEO_PATTERN
        self.memory.define(data, in_flash=in_flash, of_video=of_video)

    def _configure(self, data: bytes) -> None:
        self._require(_FLASH, _VIDEO_PATTERN, _ON_THE_FLY, stopped=True, powered=True)
        count, most = struct.unpack("<HI", data)
        self.memory.configure(count & 0x7FF, most)
        if self._mode == _VIDEO_PATTERN:
            self._video.check_lut()

    def _reorder(self, data: bytes) -> None:
        self._require(_FLASH, _ON_THE_FLY, stopped=True, powered=True)
        if len(data) < 8 or len(data) % 2:
            raise RefusedError(RefusalCode.PARAMETER, f"{len(data)} bytes of data")
        count, most = struct.unpack_from("<HI", data)
        order = struct.unpack_from(f"<{(len(data) - 6) // 2}H", data, 6)
        if count & 0x7FF != len(order):
            raise RefusedError(RefusalCode.PARAMETER, f"{count} entries stated of {len(order)}")
        self.memory.reorder(order, most)

    # Images

    def _begin_image(self, data: bytes, half: int = 0) -> None:
        self._require(_ON_THE_FLY, stopped=True, powered=True)
        index, length = struct.unpack("<HI", data)
        self.memory.begin_image(half, index & 0x1F, length)

    def _load(self, data: bytes, half: int = 0) -> None:
        self._require(_ON_THE_FLY, stopped=True, powered=True)
        self.memory.add_data(half, data, acked=self._acked)

    # Lines and the video input

    def connect_video(self, refresh_hz: float) -> None:
        """Begin a signal of `refresh_hz` pictures a second; `drive_video` brings each of them."""
        with self._lock:
            self._video.connect(refresh_hz)

    def disconnect_video(self, at_ns: int) -> None:
        """End the signal."""
        with self._lock:
            self._video.disconnect(at_ns, of_patterns=self._mode == _VIDEO_PATTERN)

    def drive_video(self, words: DecodedWords, at_ns: int) -> None:
        """A picture of the signal begins (`VideoInput.show`)."""
        with self._lock:
            if self._mode in (_VIDEO, _VIDEO_PATTERN) and self._power == _NORMAL and not self._idle:
                self._video.show(words, at_ns, of_patterns=self._mode == _VIDEO_PATTERN)

    def drive_line(self, number: Literal[1, 2], level: bool, at_ns: int) -> None:
        """Set the level of TRIG_IN_1 or TRIG_IN_2 at that time."""
        with self._lock:
            begins = self._registers.drive(number, level)
            if begins is None:
                return
            self.sequencer.settle(at_ns)
            if number == 1:
                if begins:
                    self.sequencer.trigger(at_ns, self._registers.delay_us)
                return
            ready = self._power == _NORMAL and not self._idle
            if not begins and ready and self.sequencer.active:
                self.sequencer.stop(at_ns)
            elif begins and ready and self.memory.entries:
                self.sequencer.start(at_ns, self._make_program())

    def list_pulses(
        self, number: Literal[1, 2], low_ns: int, high_ns: int
    ) -> list[tuple[int, int]]:
        """When TRIG_OUT_1 or TRIG_OUT_2 became active and inactive, for patterns of that
        interval."""
        with self._lock:
            delays_us = self._registers.delays_us(number)
            return self.sequencer.list_pulses(number, low_ns, high_ns, delays_us)

    def list_changes(self, low_ns: int, high_ns: int) -> list[tuple[int, PlayedContent]]:
        """What its mirrors showed from `low_ns` on, and each change before `high_ns`."""
        with self._lock:
            return self.sequencer.list_changes(low_ns, high_ns)

    def find_content(self) -> PlayedContent:
        """What they show now."""
        with self._lock:
            return self.sequencer.content_at(self.clock.now_ns())

    def _set_register(self, data: bytes) -> None:
        self._require(stopped=self._code in TRIGGER_REGISTERS)
        self._registers.write(self._code, data)

    # What is read

    def _read_status(self) -> bytes:
        aborted = self.sequencer.aborted
        return bytes([0x01 | self.model.dual << 4 | aborted << 6 | aborted << 7])

    def _read_main_status(self) -> bytes:
        parked, locked = self._power != _NORMAL, self._video.locked
        return bytes([parked | self.sequencer.active << 1 | locked << 3 | locked << 4])

    def _read_least_exposures(self) -> bytes:
        """Least exposure of one bit; zeros for more bits, which are not modelled."""
        return struct.pack("<H", self.model.least_exposure_us).ljust(32, b"\0")

    _commands: ClassVar[dict[int, _Command]] = {
        DmdRegister.ERROR_CODE: _Command(read=lambda self: bytes([self._error])),
        DmdRegister.ERROR_TEXT: _Command(read=lambda self: bytes(self._text)),
        DmdRegister.POWER: _Command(_set_power, 1, lambda self: bytes([self._power])),
        DmdRegister.IDLE: _Command(_set_idle, 1, lambda self: bytes([self._idle])),
        DmdRegister.VERSION: _Command(read=lambda _: _VERSION),
        DmdRegister.HARDWARE: _Command(
            read=lambda self: bytes([self.model.hardware]) + _TAG.ljust(31, b"\0")
        ),
        DmdRegister.HARDWARE_STATUS: _Command(read=_read_status),
        DmdRegister.SYSTEM_STATUS: _Command(read=lambda _: b"\x01"),
        DmdRegister.MAIN_STATUS: _Command(read=_read_main_status),
        DmdRegister.MODE: _Command(_set_mode, 1, lambda self: bytes([self._mode])),
        DmdRegister.RUN: _Command(_run),
        DmdRegister.IMAGE_BEGIN: _Command(_begin_image, 6),
        DmdRegister.IMAGE_DATA: _Command(_load, None),
        DmdRegister.SECOND_BEGIN: _Command(lambda self, data: self._begin_image(data, 1), 6),
        DmdRegister.SECOND_DATA: _Command(lambda self, data: self._load(data, 1), None),
        DmdRegister.LUT_CONFIGURE: _Command(
            _configure, 6, lambda self: struct.pack("<HI", *self.memory.counts)
        ),
        DmdRegister.LUT_REORDER: _Command(_reorder, None),
        DmdRegister.LUT_DEFINE: _Command(_define, 12),
        **dict.fromkeys(
            REGISTER_LENGTHS,
            _Command(_set_register, None, lambda self: self._registers.read(self._code)),
        ),
        DmdRegister.LEAST_EXPOSURE: _Command(read=_read_least_exposures),
    }
