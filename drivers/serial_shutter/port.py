"""A serial port as the shutter uses it: opened once, lines at rest, errors in pdcd's words.

What the lines do on their own, by pyserial 3.5 and Linux:

- pyserial asserts RTS and DTR when it opens a port unless both were set before.
- The kernel asserts both when a UART or USB adapter is opened, before any program can speak. So
  there may be a pulse of microseconds to milliseconds at each open, also when another program
  opens the port (`TIOCEXCL` keeps others out, root excepted). Hence: opened once, kept open.
- At the last close the kernel drops both lines if HUPCL is set and leaves them if it is clear.
  That is the last safety when every process was killed. It is set where dropping closes the
  shutter, and cleared where it would open it (a line active low) or would reset the box at the
  next start (commands to an Arduino).
"""

from __future__ import annotations

import errno
import fcntl
import io
import os
import stat
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import serial

from pdcd.driver import ConfigError, DeviceLost, ExposureError

from .options import SerialOptions

_HINTS = {
    errno.ENOENT: "is it plugged in? see /dev/serial/by-id",
    errno.EACCES: "add the daemon's user to the group dialout",
    errno.EBUSY: "another program holds it: fuser -v names it",
    errno.EAGAIN: "another program holds it: fuser -v names it",
}
_CFLAG = 2
_LOOK_S = 0.001
_READ_S = 0.2
"""Longest that one read may last."""


class Port:
    """An open port. Raises DeviceLost when it cannot be opened or stops answering."""

    def __init__(self, options: SerialOptions, look: Callable[[], None] = lambda: None) -> None:
        """`look()` is called while waiting for the box; an exception from it ends the wait."""
        self._options = options
        self._look = look
        self._idle = options.active_low
        self._serial = self._opened()
        try:
            self._claim()
        except BaseException:
            self._serial.close()
            raise

    @property
    def fd(self) -> int | None:
        """File descriptor; None for ports that are not on this machine."""
        try:
            return int(self._serial.fileno())
        except (io.UnsupportedOperation, AttributeError):
            return None

    @property
    def release(self) -> tuple[str, str]:
        """How to close the shutter: see `drivers.serial_shutter.guardian.release_shutter`."""
        if self._options.release == "command":
            return "command", self._options.close_hex
        return self._options.release, str(int(self._idle))

    def drive(self, *, opened: bool) -> None:
        """Hold the line, or send the command and check the reply.

        Raises ExposureError for a wrong reply, ConfigError for a port without modem lines.
        """
        with self._errors():
            if self._options.release == "rts":
                self._serial.rts = opened != self._idle
            elif self._options.release == "dtr":
                self._serial.dtr = opened != self._idle
            else:
                self._command(opened=opened)

    def shutter_is_open(self) -> bool:
        """What the feedback input says."""
        with self._errors():
            level = self._serial.cts if self._options.feedback == "cts" else self._serial.dsr
        return bool(level) != self._options.feedback_active_low

    def close(self) -> None:
        """Give the port back. Idempotent."""
        self._serial.close()

    def _opened(self) -> serial.Serial:
        options = self._options
        try:
            port = serial.serial_for_url(
                options.port,
                do_not_open=True,
                baudrate=options.baud,
                timeout=min(options.answer_s, _READ_S),
            )
            if options.release != "command":
                # At rest before the port is open; boxes on USB need both lines to talk at all.
                port.rts = self._idle and options.release == "rts"
                port.dtr = self._idle and options.release == "dtr"
            if "://" not in options.port:
                port.exclusive = True
                port.write_timeout = options.answer_s  # rfc2217 has none
            port.open()
        except (ValueError, NotImplementedError) as err:  # an unknown scheme or baud rate
            raise ConfigError(
                f"[trigger.options] port = {options.port!r}: {err}", device="shutter"
            ) from err
        except (OSError, termios.error) as err:
            number = err.args[0] if err.args and isinstance(err.args[0], int) else None
            raise DeviceLost(
                f"cannot open {options.port}: {os.strerror(number) if number else err}",
                device="shutter",
                hint=_HINTS.get(number or 0, "is it a serial port?"),
            ) from err
        return port

    def _claim(self) -> None:
        """Keep other programs out, and settle what the last close does to the lines."""
        if self.fd is None or self._bytes_alone():
            return
        with self._errors():
            fcntl.ioctl(self.fd, termios.TIOCEXCL)
            attributes = termios.tcgetattr(self.fd)
            attributes[_CFLAG] &= ~termios.HUPCL
            if self._options.release != "command" and not self._idle:
                attributes[_CFLAG] |= termios.HUPCL
            termios.tcsetattr(self.fd, termios.TCSANOW, attributes)

    def _bytes_alone(self) -> bool:
        """Whether this is a connection (``socket://``), which has no modem lines and needs none."""
        if self._options.release != "command" or self._options.feedback != "none":
            return False
        return self.fd is not None and stat.S_ISSOCK(os.fstat(self.fd).st_mode)

    def _command(self, *, opened: bool) -> None:
        options = self._options
        word, reply = (
            (options.open_hex, options.open_reply_hex)
            if opened
            else (options.close_hex, options.close_reply_hex)
        )
        expected = bytes.fromhex(reply)
        self._serial.reset_input_buffer()
        self._serial.write(bytes.fromhex(word))
        self._sent(word)
        answer = self._answer(len(expected))
        if not answer and expected:
            raise DeviceLost(
                f"no reply to {word} within {options.answer_s:g} s",
                device="shutter",
                hint="check the box's power, port, baud and reply bytes",
            )
        if answer != expected:
            raise ExposureError(
                f"the box answered {answer.hex(' ')} to {word}, not {reply}",
                device="shutter",
                hint="compare open_reply_hex and close_reply_hex with its manual",
            )

    def _answer(self, count: int) -> bytes:
        """Read `count` bytes; fewer when they do not arrive in time."""
        answer, until_s = b"", time.monotonic() + self._options.answer_s
        while len(answer) < count and time.monotonic() < until_s:
            self._look()
            answer += self._serial.read(count - len(answer))
        return answer

    def _sent(self, word: str) -> None:
        """Return once all is sent. Without this limit the kernel would wait forever for a box that
        hangs."""
        until_s = time.monotonic() + self._options.answer_s
        while "://" not in self._options.port and self._serial.out_waiting:
            self._look()
            if time.monotonic() > until_s:
                raise DeviceLost(
                    f"{self._options.port} did not take {word} within {self._options.answer_s:g} s",
                    device="shutter",
                    hint="does the box hang? check its power, and that the shutter is closed",
                )
            time.sleep(_LOOK_S)
        self._serial.flush()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        # pyserial's own exception is an OSError; termios.error is not.
        except (OSError, termios.error) as err:
            port = self._options.port
            if err.args and err.args[0] in (errno.ENOTTY, errno.EINVAL):
                raise ConfigError(
                    f"{port} has no modem lines", device="shutter", hint="release = 'command'?"
                ) from err
            raise DeviceLost(
                f"{port} does not answer: {err}",
                device="shutter",
                hint="was it unplugged? check that the camera's shutter is closed",
            ) from err
