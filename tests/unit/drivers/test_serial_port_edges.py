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
from pdcd.errors import ConfigError, DeviceLost, ExposureError

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
        return bytes(self.__dict__["reply"])

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
    Port(options(baud=19200, answer_s=0.7, **given))
    assert wire.told() == [("rts", rts), ("dtr", dtr), "open"]
    assert wire.__dict__["made"] == (
        "line://box",
        {"do_not_open": True, "baudrate": 19200, "timeout": 0.7},
    )


def test_a_box_keeps_the_lines_that_pyserial_gives_it(wire: Wire) -> None:
    Port(options(**BOX))
    assert wire.told() == ["open"]


def test_a_port_of_this_machine_is_for_one_program_and_never_waits_to_write(wire: Wire) -> None:
    Port(options(port="/dev/ttyUSB7", answer_s=0.7, **BOX))
    assert wire.told() == [("exclusive", True), ("write_timeout", 0.7), "open"]


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
        (OSError(errno.EIO, "x"), r"Input/output error .*is it a serial port"),
        (OSError("only words"), r"only words .*is it a serial port"),
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


def test_a_fault_of_the_program_is_not_called_one_of_the_port(wire: Wire) -> None:
    wire.fail(RuntimeError("a bug"))
    with pytest.raises(RuntimeError, match="a bug"):
        Port(options())


@pytest.mark.parametrize("error", [io.UnsupportedOperation("fileno"), AttributeError("fileno")])
def test_a_port_elsewhere_has_no_file_descriptor(wire: Wire, error: Exception) -> None:
    wire.__dict__["fileno_fails"] = error
    assert Port(options()).fd is None
    wire.__dict__["fileno_fails"] = RuntimeError("a bug")
    with pytest.raises(RuntimeError, match="a bug"):
        Port(options())
    assert wire.told()[-1] == "close"


# Claiming a port of this machine.


class Terminal:
    """A terminal whose last close drops its lines, or not, and what the port asks of it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, drops: bool) -> None:
        self.near, self.far = os.openpty()
        self.asked: list[int] = []
        self.fails: Exception | None = None
        settings = termios.tcgetattr(self.far)
        settings[2] = settings[2] | termios.HUPCL if drops else settings[2] & ~termios.HUPCL
        termios.tcsetattr(self.far, termios.TCSANOW, settings)
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

    def drops(self) -> bool:
        return bool(termios.tcgetattr(self.far)[2] & termios.HUPCL)

    def close(self) -> None:
        os.close(self.near)
        os.close(self.far)


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize(
    ("given", "after"),
    [({}, True), ({"active_low": True}, False), (BOX, False)],
)
def test_the_last_close_drops_the_lines_where_that_closes_the_shutter_whatever_it_did_before(
    monkeypatch: pytest.MonkeyPatch, before: bool, given: dict[str, Any], after: bool
) -> None:
    terminal = Terminal(monkeypatch, drops=before)
    port = Port(options(**given))
    assert port.fd == terminal.far
    assert terminal.asked == [termios.TIOCEXCL]  # nobody else may open it from here on
    assert terminal.drops() == after
    terminal.close()


@pytest.mark.parametrize(
    ("error", "becomes"),
    [
        (OSError(errno.EIO, "gone"), DeviceLost),
        (termios.error(errno.EIO, "gone"), DeviceLost),
        (termios.error(errno.ENOTTY, "no terminal"), ConfigError),
        (RuntimeError("a bug"), RuntimeError),
    ],
)
def test_a_port_that_cannot_be_claimed_is_given_back(
    monkeypatch: pytest.MonkeyPatch, error: Exception, becomes: type[Exception]
) -> None:
    terminal = Terminal(monkeypatch, drops=False)
    terminal.fails = error
    with pytest.raises(becomes):
        Port(options())
    assert terminal.serial.told()[-1] == "close"
    terminal.close()


# The open port.


@pytest.mark.parametrize(
    ("error", "becomes", "said"),
    [
        (OSError(errno.ENOTTY, "x"), ConfigError, "no modem lines"),
        (OSError(errno.EINVAL, "x"), ConfigError, "no modem lines"),
        (termios.error(errno.ENOTTY, "x"), ConfigError, "no modem lines"),
        (OSError(errno.EIO, "x"), DeviceLost, "does not answer.*unplugged"),
        (OSError(), DeviceLost, "does not answer"),
        (termios.error(errno.EIO, "x"), DeviceLost, "does not answer"),
        (serial.SerialException("gone"), DeviceLost, "does not answer: gone"),
        (RuntimeError("a bug"), RuntimeError, "a bug"),
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


def test_a_command_is_on_its_way_before_its_reply_is_read(wire: Wire) -> None:
    """And what came before it is thrown away first."""
    port = Port(options(**BOX, open_reply_hex="4F 4B", close_reply_hex=""))
    wire.told()
    wire.__dict__["reply"] = b"OK"
    port.drive(opened=True)
    assert wire.told() == ["reset", ("write", b"1"), "flush", ("read", 2)]
    port.drive(opened=False)  # says nothing, and is not waited for
    assert wire.told() == ["reset", ("write", b"0"), "flush"]
    wire.__dict__["reply"] = b"O"  # cut short: that is an answer, but not the right one
    with pytest.raises(ExposureError, match="answered 4f to 31, not 4F 4B"):
        port.drive(opened=True)


def test_a_closed_port_is_given_back(wire: Wire) -> None:
    port = Port(options())
    wire.told()
    port.close()
    assert wire.told() == ["close"]


# Its options.


def read(**given: Any) -> SerialOptions:
    return msgspec.convert({"port": "line://box", **given}, SerialOptions)


def test_what_is_not_said_is_a_line_that_is_held_and_no_feedback() -> None:
    made = read()
    assert (made.release, made.active_low, made.feedback) == ("rts", False, "none")
    assert (made.baud, made.ready_s, made.answer_s) == (9600, 0.0, 1.0)
    assert (made.feedback_active_low, made.limit_s) == (False, None)


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
        assert getattr(read(**{name: value}), name) == value
    for value in bad:
        with pytest.raises(msgspec.ValidationError, match=name):
            read(**{name: value})


@pytest.mark.parametrize("given", [{"open_hex": "31"}, {"close_hex": "30"}])
def test_a_box_needs_both_commands(given: dict[str, str]) -> None:
    with pytest.raises(msgspec.ValidationError, match="needs open_hex and close_hex"):
        read(release="command", **given)


@pytest.mark.parametrize("name", ["open_hex", "close_hex", "open_reply_hex"])
def test_a_line_has_no_commands(name: str) -> None:
    with pytest.raises(msgspec.ValidationError, match="need release = 'command'"):
        read(**{name: "31"})


def test_options_are_given_by_name_and_stay_as_they_are() -> None:
    made = read()
    with pytest.raises(AttributeError):
        made.baud = 300  # type: ignore[misc]
    with pytest.raises(TypeError):
        SerialOptions("line://box")  # type: ignore[call-arg]
    with pytest.raises(msgspec.ValidationError, match="relese"):
        read(relese="rts")


@pytest.mark.parametrize("left", [[3, 1, 0], [0]])
def test_a_command_is_waited_for_until_it_is_sent(wire: Wire, left: list[int]) -> None:
    port = Port(options(port="/dev/ttyUSB7", **BOX))
    wire.told()
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
