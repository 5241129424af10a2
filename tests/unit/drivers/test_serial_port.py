"""The serial shutter on real terminals and over TCP: what pyserial, the kernel and a dead daemon do
to the line. A pseudo-terminal stands in for the adapter; it has no modem lines of its own."""

from __future__ import annotations

import fcntl
import os
import select
import signal
import socket
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest
import serial
import serial.rfc2217

from drivers.serial_shutter import SerialShutter, guardian, watchdog
from pdcd.bench.clock import RealClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import Config, RigConfig, TriggerConfig
from pdcd.errors import ConfigError, DeviceLost, ExposureError
from tests.fake_serial import modem_lines
from tests.places import ROOT
from tests.processes import LONG_S, ended, send_every_signal

BOX = {"release": "command", "open_hex": "31", "close_hex": "30"}


@pytest.fixture
def pty() -> Iterator[SimpleNamespace]:
    """Both ends of a pseudo-terminal: `near` is a file descriptor, `path` the port's name.

    `freed` does what the last close of a port does: it may be opened anew. This fixture holds its
    far end open, so the kernel would keep all but root out once one had it for itself.
    """
    near, far = os.openpty()

    def freed() -> None:
        fcntl.ioctl(far, termios.TIOCNXCL)

    yield SimpleNamespace(near=near, path=os.ttyname(far), freed=freed)
    for end in (near, far):
        os.close(end)


def make(port: str, **options: Any) -> SerialShutter:
    trigger = TriggerConfig(lag_s=0.001, jitter_s=0.0, options={"port": port, **options})
    config = Config(trigger=trigger, rig=RigConfig(clock="real"))
    return SerialShutter.create(DriverContext(config=config, clock=RealClock()))


def heard(near: int, count: int) -> bytes:
    """The next bytes on the box's side."""
    data = b""
    while len(data) < count and select.select([near], [], [], LONG_S)[0]:
        data += os.read(near, count - len(data))
    return data


def test_commands_cross_a_terminal(pty: SimpleNamespace) -> None:
    box = make(pty.path, **BOX)
    identity = box.connect()
    assert (identity["release"], identity["watchdog"]) == ("command, 31 / 30", "guardian")
    box.open()
    box.close()
    box.disconnect()
    assert heard(pty.near, 3) == b"010"


# The lines of a port, as pyserial's own code for Linux sets them.


@pytest.mark.parametrize("active_low", [False, True])
def test_lines_are_at_rest_from_the_moment_the_port_opens(
    pty: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, active_low: bool
) -> None:
    lines = modem_lines(monkeypatch)
    box = make(pty.path, active_low=active_low)
    box.connect()
    rest, hold = ("set", "clear") if active_low else ("clear", "set")
    assert set(lines.calls) == {(rest, "rts"), ("clear", "dtr")}
    lines.calls.clear()
    box.open()
    assert lines.calls == [(hold, "rts")]
    box.close()
    assert lines.calls == [(hold, "rts"), (rest, "rts")]
    box.disconnect()


@pytest.mark.parametrize(
    ("options", "drop"),
    [({}, True), ({"active_low": True}, False), ({"release": "dtr"}, True), (BOX, False)],
)
def test_the_last_close_drops_the_lines_only_where_that_closes_the_shutter(
    pty: SimpleNamespace,
    monkeypatch: pytest.MonkeyPatch,
    options: dict[str, Any],
    drop: bool,
) -> None:
    modem_lines(monkeypatch)
    box = make(pty.path, **options)
    box.connect()
    look = os.open(pty.path, os.O_RDWR | os.O_NOCTTY) if os.geteuid() == 0 else pty.near
    try:
        control = termios.tcgetattr(look)[2]
    finally:
        if look != pty.near:
            os.close(look)
    assert bool(control & termios.HUPCL) == drop
    box.disconnect()


def test_a_second_daemon_is_kept_out(pty: SimpleNamespace) -> None:
    first, second = make(pty.path, **BOX), make(pty.path, **BOX)
    first.connect()
    with pytest.raises(DeviceLost, match="another program holds it"):
        second.connect()
    first.disconnect()
    pty.freed()
    second.connect()
    second.disconnect()


def test_a_port_without_modem_lines_says_so(pty: SimpleNamespace) -> None:
    with pytest.raises(ConfigError, match="no modem lines"):
        make(pty.path).connect()


def test_unplugged(pty: SimpleNamespace) -> None:
    near, far = os.openpty()
    box = make(os.ttyname(far), **BOX)
    box.connect()
    box.open()
    os.close(far)
    os.close(near)
    with pytest.raises(DeviceLost, match="unplugged"):
        box.close()
    with pytest.raises(DeviceLost):
        box.disconnect()


# The guardian.

DAEMON = """
import sys, time
from tests.unit.drivers.test_serial_port import BOX, make
box = make(sys.argv[1], limit_s=float(sys.argv[2]), **BOX)
box.connect()
if sys.argv[3] == "open":
    box.open()
last = None
while True:  # tell of each guardian when it is armed
    with box._watchdog._guard._lock:
        pid = box._watchdog.pid
    if pid not in (None, last):
        print(pid, flush=True)
        last = pid
    time.sleep(0.01)
"""


def daemon(port: str, limit_s: float, state: str) -> tuple[subprocess.Popen[str], int]:
    """Another process that holds the shutter, and its guardian's process id."""
    root = str(ROOT)
    process = subprocess.Popen(
        [sys.executable, "-c", DAEMON, port, str(limit_s), state],
        cwd=root,
        env={**os.environ, "PYTHONPATH": root},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    return process, int(process.stdout.readline())


def finish(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()
    assert process.stdout is not None
    process.stdout.close()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV])
def test_the_shutter_closes_when_the_daemon_is_killed(
    pty: SimpleNamespace, number: signal.Signals
) -> None:
    process, pid = daemon(pty.path, 600.0, "open")
    assert heard(pty.near, 2) == b"01"
    os.kill(process.pid, number)
    assert heard(pty.near, 1) == b"0"
    assert ended(pid)
    finish(process)
    pty.freed()
    again = make(pty.path, **BOX)  # nothing holds the port any more
    again.connect()
    again.disconnect()


def test_the_guardian_survives_every_signal_but_the_last(pty: SimpleNamespace) -> None:
    """Whoever ends a whole service means the daemon; its guardian has still to do its part."""
    process, pid = daemon(pty.path, 600.0, "open")
    assert heard(pty.near, 2) == b"01"
    send_every_signal(pid)
    finish(process)
    assert heard(pty.near, 1) == b"0"
    assert ended(pid)


def test_the_shutter_closes_when_the_daemon_is_stuck(pty: SimpleNamespace) -> None:
    process, pid = daemon(pty.path, 0.05, "open")
    os.kill(process.pid, signal.SIGSTOP)
    assert heard(pty.near, 3) == b"010"
    finish(process)
    assert ended(pid)


def test_a_closed_shutter_is_left_alone_when_the_daemon_dies(pty: SimpleNamespace) -> None:
    process, pid = daemon(pty.path, 600.0, "closed")
    finish(process)
    assert ended(pid)
    assert heard(pty.near, 1) == b"0"
    assert not select.select([pty.near], [], [], 0.0)[0]


def test_an_exposure_that_the_guardian_ended_is_refused(pty: SimpleNamespace) -> None:
    # Far longer than a busy machine takes from the guardian's start of the time to the command.
    box = make(pty.path, limit_s=0.5, **BOX)
    box.connect()
    box.open()
    assert heard(pty.near, 3) == b"010"
    with pytest.raises(ExposureError, match="watchdog"):
        box.close()
    box.close()  # said once: the rig asks again until it hears that the shutter is closed
    box.open()
    box.disconnect()


def test_a_guardian_that_died_is_replaced(pty: SimpleNamespace) -> None:
    box = make(pty.path, **BOX)
    box.connect()
    guard = box._watchdog
    assert isinstance(guard, watchdog.Guardian) and guard.pid is not None
    first = guard.pid
    os.kill(first, signal.SIGKILL)
    assert ended(first)
    box.open()
    assert guard.pid is not None and guard.pid != first
    box.close()  # the driver closes the shutter itself
    box.disconnect()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_guardian_lost_in_an_exposure_is_replaced_by_one_that_guards_it(
    pty: SimpleNamespace, number: int
) -> None:
    process, pid = daemon(pty.path, 600.0, "open")
    assert heard(pty.near, 2) == b"01"
    os.kill(pid, number)
    assert ended(pid)
    assert process.stdout is not None
    another = int(process.stdout.readline())
    assert another != pid
    assert not select.select([pty.near], [], [], 0.0)[0]  # the exposure goes on
    finish(process)
    assert heard(pty.near, 1) == b"0"
    assert ended(another)


def test_an_exposure_that_nobody_guards_is_ended(
    pty: SimpleNamespace,
) -> None:
    box = make(pty.path, **BOX)
    box.connect()
    box.open()
    assert heard(pty.near, 2) == b"01"
    guard = box._watchdog
    assert isinstance(guard, watchdog.Guardian) and guard.pid is not None
    guard._guard._command = ("/none/python",)
    os.kill(guard.pid, signal.SIGKILL)
    assert heard(pty.near, 1) == b"0"
    with pytest.raises(ExposureError, match="watchdog ended the exposure: cannot start"):
        box.close()
    box.disconnect()


def test_a_guardian_that_does_not_start_keeps_the_shutter_closed(
    pty: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watchdog, "SERIAL_GUARDIAN", ("/none/python",))
    with pytest.raises(DeviceLost, match="cannot start the process that guards"):
        make(pty.path, **BOX).connect()
    pty.freed()
    monkeypatch.setattr(watchdog, "SERIAL_GUARDIAN", ("/bin/false",))
    box = make(pty.path, **BOX)
    box.connect()
    with pytest.raises(DeviceLost, match="guards the shutter does not start"):
        box.open()
    box.disconnect()
    assert b"1" not in heard(pty.near, 3)


@pytest.mark.parametrize(
    ("how", "value", "expected"),
    [
        ("rts", "0", (termios.TIOCMBIC, termios.TIOCM_RTS)),
        ("rts", "1", (termios.TIOCMBIS, termios.TIOCM_RTS)),
        ("dtr", "0", (termios.TIOCMBIC, termios.TIOCM_DTR)),
    ],
)
def test_the_guardian_puts_the_line_at_rest_once_the_other_end_is_gone(
    monkeypatch: pytest.MonkeyPatch, how: str, value: str, expected: tuple[int, int]
) -> None:
    calls: list[tuple[int, int]] = []

    def ioctl(fd: int, request: int, bits: bytes) -> None:
        calls.append((request, int.from_bytes(bits, sys.byteorder)))
        if len(calls) == 1:
            raise OSError(5, "Input/output error")  # it tries again

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        with ours:
            ours.send(b"arm 600")
        guardian.run_serial_guardian(-1, how, value, theirs)
    assert calls == [expected, expected]


# Over TCP, as ser2net and the like serve ports.


class RemoteLine:
    """The port object behind `serial.rfc2217.PortManager`: only what it asks for."""

    def __init__(self) -> None:
        self.levels: list[bool] = []
        self.dtr = self.dsr = self.ri = self.cd = False
        self.baudrate, self.bytesize, self.parity, self.stopbits = 9600, 8, "N", 1
        self.xonxoff = self.rtscts = self.break_condition = False

    @property
    def rts(self) -> bool:
        return bool(self.levels and self.levels[-1])

    @rts.setter
    def rts(self, level: bool) -> None:
        self.levels.append(level)

    @property
    def cts(self) -> bool:
        return self.rts

    def get_settings(self) -> dict[str, Any]:
        return {}

    def apply_settings(self, settings: dict[str, Any]) -> None: ...

    def reset_input_buffer(self) -> None: ...

    def reset_output_buffer(self) -> None: ...

    def flush(self) -> None: ...


def serve(listener: socket.socket, line: RemoteLine) -> None:
    """One client of a telnet serial server."""
    connection, _ = listener.accept()
    lock = threading.Lock()

    def write(data: bytes) -> None:
        with lock:
            connection.sendall(data)

    manager = serial.rfc2217.PortManager(cast(Any, line), cast(Any, SimpleNamespace(write=write)))
    with connection:
        while data := connection.recv(1024):
            for _ in manager.filter(data):
                pass
            manager.check_modem_lines()


@pytest.mark.filterwarnings("ignore:set(Daemon|Name)")  # pyserial's own
def test_the_line_of_a_port_server() -> None:
    line = RemoteLine()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        server = threading.Thread(target=serve, args=(listener, line))
        server.start()
        box = make(f"rfc2217://127.0.0.1:{listener.getsockname()[1]}", answer_s=10.0)
        assert box.connect()["watchdog"] == "alarm"
        assert not any(line.levels)
        box.open()
        assert line.levels[-1] is True
        box.close()
        assert line.levels[-1] is False
        box.disconnect()
        server.join(LONG_S)
        assert not server.is_alive()


@pytest.fixture
def relay() -> Iterator[SimpleNamespace]:
    """A box on the network: `heard` is what it was sent, the end of the connection included."""
    heard: list[bytes] = []

    def listen() -> None:
        connection, _ = listener.accept()
        with connection:
            while data := connection.recv(1):
                heard.append(data)
        heard.append(b"")

    with socket.create_server(("127.0.0.1", 0)) as listener:
        server = threading.Thread(target=listen, daemon=True)
        server.start()
        url = f"socket://127.0.0.1:{listener.getsockname()[1]}"
        yield SimpleNamespace(url=url, heard=heard, server=server)
    server.join(LONG_S)
    assert not server.is_alive()


@pytest.mark.parametrize("last", ["close", "guardian"])
def test_a_box_on_the_network_takes_commands_and_has_a_guardian(
    relay: SimpleNamespace, last: str
) -> None:
    box = make(relay.url, **BOX)
    assert box.connect()["watchdog"] == "guardian"
    box.open()
    if last == "close":
        box.close()
    elif box._watchdog is not None:
        box._watchdog.stop()  # as when this process dies
        box._watchdog = None
    box.disconnect()
    relay.server.join(LONG_S)
    assert relay.heard == [b"0", b"1", b"0", *[b"0"] * (last == "close"), b""]


@pytest.mark.parametrize("lines", [{}, {**BOX, "feedback": "cts"}])
def test_a_connection_without_lines_says_so(relay: SimpleNamespace, lines: dict[str, str]) -> None:
    with pytest.raises(ConfigError, match="no modem lines"):
        make(relay.url, **lines).connect()
