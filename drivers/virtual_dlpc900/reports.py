"""Reports of 64 bytes and the commands in them, as the virtual DLPC900 takes and answers them.

A command is flags, a sequence byte, the length of all that follows, the command and its data, in as
many reports as needed; reports after the first hold only data. A reply does not repeat the command.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

USB_REPORT_LENGTH = 64
_LONGEST_COMMAND = 512
"""Bytes of a whole command: those of the device's buffer."""
_HEAD = struct.Struct("<BBHH")
_READS, _ANSWERS, _FAILED, _FOR_OTHERS = 0x80, 0x40, 0x20, 0x07


@dataclass(frozen=True)
class TakenCommand:
    """A command as it arrived: what it is, what it brings, and what its sender wants back."""

    flags: int
    sequence: int
    code: int
    data: bytes
    too_long: bool = False

    @property
    def reads(self) -> bool:
        """Whether it reads a value."""
        return bool(self.flags & _READS)

    @property
    def wants_reply(self) -> bool:
        """Whether a reply is to be sent."""
        return bool(self.flags & _ANSWERS)

    @property
    def for_others(self) -> bool:
        """Whether it is for something other than the controller of the mirrors."""
        return bool(self.flags & _FOR_OTHERS)

    def answer(self, data: bytes = b"", *, failed: bool = False) -> bytes:
        """The report that answers it, padded to 64 bytes."""
        flags = self.flags | (_FAILED if failed else 0)
        reply = struct.pack("<BBH", flags, self.sequence, len(data)) + data
        return reply.ljust(USB_REPORT_LENGTH, b"\0")


class ReportAssembler:
    """Puts the reports of one command together."""

    def __init__(self) -> None:
        self._taken = bytearray()
        self._whole = 0

    def add(self, report: bytes) -> TakenCommand | None:
        """Take a report; returns the command once it is complete. Shorter reports are padded with
        zeros, as for the device."""
        padded = report[:USB_REPORT_LENGTH].ljust(USB_REPORT_LENGTH, b"\0")
        if not self._whole:
            self._whole = 4 + max(2, struct.unpack_from("<H", padded, 2)[0])
        self._taken += padded
        if len(self._taken) < self._whole:
            return None
        taken, whole = bytes(self._taken), self._whole
        self.forget()
        flags, sequence, _, code = _HEAD.unpack_from(taken)
        data = taken[_HEAD.size : whole]
        return TakenCommand(flags, sequence, code, data, whole > _LONGEST_COMMAND)

    def forget(self) -> None:
        """Discard what has come of an incomplete command."""
        self._taken.clear()
        self._whole = 0
