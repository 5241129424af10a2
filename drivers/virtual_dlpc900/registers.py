"""Registers of the virtual DLPC900: its trigger lines, and those that have no effect here."""

from __future__ import annotations

import struct
from typing import Literal

from .model import DmdRegister, RefusalCode, RefusedError

REGISTER_LENGTHS: dict[int, int] = {
    DmdRegister.TRIGGER_OUT_1: 5,
    DmdRegister.TRIGGER_OUT_2: 5,
    DmdRegister.TRIGGER_IN_1: 3,
    DmdRegister.TRIGGER_IN_2: 1,
    **dict.fromkeys((0x1A00, 0x1A01, 0x1A02, 0x1A03, 0x1A04, 0x1A37), 1),  # the video input
    **dict.fromkeys((0x1A05, 0x1A07), 1),  # LEDs
    **dict.fromkeys((0x1A1F, 0x1A20, 0x1A21), 5),
    0x0B01: 3,
    0x1100: 6,  # the colour around a picture
}
"""Bytes of each register."""
_OUTPUTS = DmdRegister.TRIGGER_OUT_1, DmdRegister.TRIGGER_OUT_2
_INPUTS = DmdRegister.TRIGGER_IN_1, DmdRegister.TRIGGER_IN_2
TRIGGER_REGISTERS = (*_OUTPUTS, *_INPUTS)
"""Registers that may be written only while nothing is shown."""
_DELAYS_US = range(-20, 20_001)


class DmdRegisters:
    """Registers that are read as they were written. An edge at the first input shows the next
    pattern, one at the second starts or stops the sequence."""

    def __init__(self, least_delay_us: int) -> None:
        self._least_us = least_delay_us
        self._levels = {1: False, 2: False}
        self.forget()

    def forget(self) -> None:
        """Reset all registers as at power-on; levels stay, as others drive them."""
        self._set: dict[int, bytes] = {
            code: bytes(length) for code, length in REGISTER_LENGTHS.items()
        } | {DmdRegister.TRIGGER_IN_1: struct.pack("<HB", self._least_us, 0)}

    def read(self, code: int) -> bytes:
        """A register as it was written."""
        return self._set[code]

    def write(self, code: int, data: bytes) -> None:
        """Set one. Raises RefusedError."""
        if code == DmdRegister.TRIGGER_IN_1:
            delay_us = int.from_bytes(data[:2], "little")
            if delay_us < self._least_us:
                raise RefusedError(RefusalCode.DELAY, f"a delay of {delay_us} us")
        elif code in _OUTPUTS:
            _, *delays_us = struct.unpack("<Bhh", data)
            if any(delay_us not in _DELAYS_US for delay_us in delays_us):
                raise RefusedError(RefusalCode.DELAY, f"delays of {delays_us} us")
        polarity = data[-1] if code in _INPUTS else data[0] if code in _OUTPUTS else 0
        if polarity > 1:
            raise RefusedError(RefusalCode.PARAMETER, f"polarity {polarity}")
        self._set[code] = data

    @property
    def delay_us(self) -> int:
        """Delay from an edge at the first input to the pattern, in us."""
        return int.from_bytes(self._set[DmdRegister.TRIGGER_IN_1][:2], "little")

    def delays_us(self, number: Literal[1, 2]) -> tuple[int, int]:
        """Delays of the rising and falling edge of an output, in us."""
        _, rise_us, fall_us = struct.unpack("<Bhh", self._set[_OUTPUTS[number - 1]])
        return rise_us, fall_us

    def drive(self, number: Literal[1, 2], level: bool) -> bool | None:
        """Set the level of an input. Returns True for the edge that begins something, False for the
        other edge, None for no edge."""
        if level is self._levels[number]:
            return None
        self._levels[number] = level
        return level is not bool(self._set[_INPUTS[number - 1]][-1])
