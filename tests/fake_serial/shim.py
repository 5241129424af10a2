"""Modem lines for a pseudo-terminal: its driver answers ENOTTY to the requests for them."""

from __future__ import annotations

import fcntl
import struct
import termios
from typing import Any

import pytest
import serial.serialposix


class ModemLines:
    """Stands in for the module `fcntl` in pyserial; passes on what is not about modem lines."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, str]] = []
        """("set" or "clear", "rts" or "dtr"), in order."""

    def __getattr__(self, name: str) -> Any:
        return getattr(fcntl, name)

    def ioctl(self, fd: int, request: int, *args: Any) -> Any:
        """Write the request down if it is one of ours."""
        verbs = {termios.TIOCMBIS: "set", termios.TIOCMBIC: "clear"}
        if request in verbs:
            (bits,) = struct.unpack("I", args[0])
            names = {termios.TIOCM_RTS: "rts", termios.TIOCM_DTR: "dtr"}
            self.calls.append((verbs[request], names[bits]))
            return args[0]
        return fcntl.ioctl(fd, request, *args)


def modem_lines(monkeypatch: pytest.MonkeyPatch) -> ModemLines:
    """pyserial's posix port with modem lines on any terminal, for one test."""
    lines = ModemLines()
    monkeypatch.setattr(serial.serialposix, "fcntl", lines)
    return lines
