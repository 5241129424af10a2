"""pyserial's handler of ``line://NAME``: its own loop port with lines that are written down."""

from __future__ import annotations

import errno
from typing import Any
from urllib.parse import urlsplit

import serial
from serial.urlhandler import protocol_loop

from tests.fake_serial.lines import LINES, FakeLine


class Serial(protocol_loop.Serial):
    """The port; `FakeLine` is what it is plugged into."""

    def from_url(self, url: str) -> None:
        """Called by open."""
        self._line_or_lost().opened += 1

    def _line_or_lost(self) -> FakeLine:
        line = LINES.get(urlsplit(self.port or "").netloc)
        if line is None:
            raise serial.SerialException(errno.ENOENT, "no such line")
        if line.unplugged:
            raise OSError(errno.EIO, "Input/output error")
        return line

    def _update_rts_state(self) -> None:
        self._line_or_lost().set("rts", self.rts)

    def _update_dtr_state(self) -> None:
        self._line_or_lost().set("dtr", self.dtr)

    @property
    def cts(self) -> bool:
        """Clear To Send."""
        return self._line_or_lost().cts()

    @property
    def dsr(self) -> bool:
        """Data Set Ready."""
        return self._line_or_lost().dsr()

    def write(self, b: Any, /) -> int | None:
        """What was sent, and what comes back."""
        line = self._line_or_lost()
        line.received.append(bytes(b))
        reply = line.answer(bytes(b))
        return super().write(reply) if reply else 0
