"""The serial port by itself: how it is opened, whom it keeps out, and what its errors become."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import termios
from typing import Any

import msgspec
import pytest
import serial

from drivers.serial_shutter.options import SerialOptions
from drivers.serial_shutter.port import Port
from pdcd.errors import ConfigError, DeviceLost

BOX: dict[str, Any] = {"release": "command", "open_hex": "31", "close_hex": "30"}


class Wire:
    """Stands in for pyserial's port and writes down what is done to it, in order."""

    def __init__(self) -> None:
        self.__dict__.update(done=[], made=(), fails=None, fileno_fails=None, reply=b"")

    def __setattr__(self, name: str, value: object) -> None:
        self._do((name, value))
        self.__dict__[name] = value

    def _do(self, what: object) -> None:
        if self.__dict__["fails"] is not None:
            raise self.__dict__["fails"]
        self.__dict__["done"].append(what)

    def make(self, url: str, **how: Any) -> Wire:
        """What `serial.serial_for_url` does."""
        self.__dict__["made"] = (url, how)
        return self

    def fileno(self) -> int:
        raise self.__dict__["fileno_fails"] or io.UnsupportedOperation("fileno")

    def open(self) -> None:
        self._do("open")

    def close(self) -> None:
        self.__dict__["done"].append("close")

    def reset_input_buffer(self) -> None:
        self._do("reset")

    def write(self, data: bytes) -> None:
        self._do(("write", data))

    def flush(self) -> None:
        self._do("flush")

    def read(self, count: int) -> bytes:
        self._do(("read", count))
        found, self.__dict__["reply"] = self.__dict__["reply"][:count], b""
        return bytes(found)

    def told(self) -> list[object]:
        """What was done since it was asked last."""
        done: list[object] = self.__dict__["done"]
        self.__dict__["done"] = []
        return done

    def fail(self, error: BaseException | None) -> None:
        """From now on with everything that is done to it."""
        self.__dict__["fails"] = error


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Wire:
    wire = Wire()
    monkeypatch.setattr(serial, "serial_for_url", wire.make)
    return wire


def options(**given: Any) -> SerialOptions:
    return SerialOptions(**{"port": "line://box", **given})


# Opening.


@pytest.mark.parametrize(
    ("given", "rts", "dtr"),
    [
        ({}, False, False),
        ({"active_low": True}, True, False),
        ({"release": "dtr", "active_low": True}, False, True),
    ],
)
def test_both_lines_are_at_rest_before_the_port_is_open(
    wire: Wire, given: dict[str, Any], rts: bool, dtr: bool
) -> None:
    port = Port(options(baud=19200, answer_s=0.7, **given))
    assert wire.told() == [("rts", rts), ("dtr", dtr), "open"]
    assert wire.__dict__["made"] == (
        "line://box",
        {"do_not_open": True, "baudrate": 19200, "timeout": 0.2},
    )
    port.close()
    assert wire.told() == ["close"]


@pytest.mark.parametrize("error", [ValueError("no baud"), NotImplementedError("no scheme")])
def test_what_pyserial_cannot_make_is_a_wrong_option(wire: Wire, error: Exception) -> None:
    wire.fail(error)
    with pytest.raises(ConfigError, match=r"\[trigger\.options\] port = 'line://box': no "):
        Port(options())


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOENT, "x"), r"No such file or directory .*/dev/serial/by-id"),
        (OSError(errno.EACCES, "x"), r"Permission denied .*dialout"),
        (OSError(errno.EBUSY, "x"), r"busy .*fuser"),
        (OSError(errno.EAGAIN, "x"), r"unavailable .*fuser"),
        (OSError(), r"cannot open line://box.*is it a serial port"),
        (termios.error(errno.EIO, "x"), r"Input/output error .*is it a serial port"),
    ],
)
def test_a_port_that_does_not_open_is_lost_for_a_reason(
    wire: Wire, error: Exception, said: str
) -> None:
    wire.fail(error)
    with pytest.raises(DeviceLost, match=said):
        Port(options())


@pytest.mark.parametrize("error", [io.UnsupportedOperation("fileno"), AttributeError("fileno")])
def test_a_port_elsewhere_has_no_file_descriptor(wire: Wire, error: Exception) -> None:
    wire.__dict__["fileno_fails"] = error
    assert Port(options()).fd is None


# Claiming a port of this machine.


class Terminal:
    """A terminal, and what the port asks of it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.near, self.far = os.openpty()
        self.asked: list[int] = []
        self.fails: Exception | None = None
        monkeypatch.setattr(fcntl, "ioctl", self._ioctl)
        self.serial = Wire()
        self.serial.__dict__["fileno"] = lambda: self.far
        monkeypatch.setattr(serial, "serial_for_url", self.serial.make)

    def _ioctl(self, fd: int, request: int, *_: object) -> int:
        assert fd == self.far
        self.asked.append(request)
        if self.fails is not None:
            raise self.fails
        return 0

    def close(self) -> None:
        os.close(self.near)
        os.close(self.far)


@pytest.mark.parametrize(
    ("error", "becomes"),
    [
        (None, None),
        (OSError(errno.EIO, "gone"), DeviceLost),
        (termios.error(errno.EIO, "gone"), DeviceLost),
        (termios.error(errno.ENOTTY, "no terminal"), ConfigError),
        (RuntimeError("a bug"), RuntimeError),
    ],
)
def test_a_port_that_cannot_be_claimed_is_given_back(
    monkeypatch: pytest.MonkeyPatch, error: Exception | None, becomes: type[Exception] | None
) -> None:
    terminal = Terminal(monkeypatch)
    terminal.fails = error
    if becomes is None:
        assert Port(options()).fd == terminal.far
    else:
        with pytest.raises(becomes):
            Port(options())
        assert terminal.serial.told()[-1] == "close"
    assert terminal.asked == [termios.TIOCEXCL]  # nobody else may open it from here on
    terminal.close()


# The open port.


@pytest.mark.parametrize(
    ("error", "becomes", "said"),
    [
        (OSError(errno.ENOTTY, "x"), ConfigError, "no modem lines"),
        (OSError(errno.EINVAL, "x"), ConfigError, "no modem lines"),
        (termios.error(errno.ENOTTY, "x"), ConfigError, "no modem lines"),
        (OSError(errno.EIO, "x"), DeviceLost, "does not answer.*unplugged"),
        (termios.error(errno.EIO, "x"), DeviceLost, "does not answer"),
        (serial.SerialException("gone"), DeviceLost, "does not answer: gone"),
    ],
)
def test_errors_of_the_open_port_come_in_our_words(
    wire: Wire, error: Exception, becomes: type[Exception], said: str
) -> None:
    port = Port(options())
    wire.fail(error)
    with pytest.raises(becomes, match=said):
        port.drive(opened=True)


@pytest.mark.parametrize(
    ("given", "how"),
    [
        ({}, ("rts", "0")),
        ({"active_low": True}, ("rts", "1")),
        ({"release": "dtr"}, ("dtr", "0")),
        ({"release": "dtr", "active_low": True}, ("dtr", "1")),
        (BOX, ("command", "30")),
    ],
)
def test_whoever_guards_the_port_is_told_how_to_close_the_shutter(
    wire: Wire, given: dict[str, Any], how: tuple[str, str]
) -> None:
    assert Port(options(**given)).release == how


# Its options.


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("baud", [50, 4_000_000], [49, 4_000_001]),
        ("ready_s", [0.0, 3600.0], [-0.001, 3600.5]),
        ("answer_s", [0.001, 10.0], [0.0, 10.001]),
        ("limit_s", [0.001, 1e6], [0.0, -1.0]),
    ],
)
def test_options_have_their_bounds(name: str, good: list[float], bad: list[float]) -> None:
    for value in good:
        read = msgspec.convert({"port": "line://box", name: value}, SerialOptions)
        assert getattr(read, name) == value
    for value in bad:
        with pytest.raises(msgspec.ValidationError, match=name):
            msgspec.convert({"port": "line://box", name: value}, SerialOptions)


def test_a_command_is_waited_for_until_it_is_sent(wire: Wire) -> None:
    left = [3, 1, 0]
    port = Port(options(port="/dev/ttyUSB7", **BOX))
    assert wire.told() == [("exclusive", True), ("write_timeout", 1.0), "open"]
    type_ = type("Slow", (Wire,), {"out_waiting": property(lambda _: left.pop(0))})
    object.__setattr__(wire, "__class__", type_)
    port.drive(opened=True)
    assert left == [] and wire.told() == ["reset", ("write", b"1"), "flush"]


def test_a_box_that_takes_nothing_is_not_waited_for_without_bound(wire: Wire) -> None:
    """The kernel would do so: only what is sent is flushed."""
    port = Port(options(port="/dev/ttyUSB7", answer_s=0.02, **BOX))
    wire.told()
    wire.__dict__["out_waiting"] = 1
    with pytest.raises(DeviceLost, match=r"/dev/ttyUSB7 did not take 31 within 0\.02 s .*box hang"):
        port.drive(opened=True)
    assert "flush" not in wire.told()
