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
from typing import Any

import pytest

from drivers.serial_shutter import SerialShutter, watchdog
from drivers.serial_shutter.port import Port
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


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
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


def test_a_guardian_lost_in_an_exposure_is_replaced_by_one_that_guards_it(
    pty: SimpleNamespace,
) -> None:
    process, pid = daemon(pty.path, 600.0, "open")
    assert heard(pty.near, 2) == b"01"
    os.kill(pid, signal.SIGKILL)
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


# Over TCP, as ser2net and the like serve ports.


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


@pytest.mark.parametrize("stopped", ["before the last look", "after it"])
def test_a_daemon_stopped_beyond_the_guardians_time_opens_nothing_unguarded(
    pty: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, stopped: str
) -> None:
    box_heard: list[bytes] = []

    def sleep_through() -> None:
        """As long as the guardian takes to send its command, which closes the shutter."""
        box_heard.append(heard(pty.near, 1))

    arm, drive = watchdog.Guardian.arm, Port.drive
    box = make(pty.path, limit_s=0.2, **BOX)
    box.connect()
    sleep_through()  # it is closed first of all

    def late_arm(guard: watchdog.Guardian, limit_s: float) -> None:
        arm(guard, limit_s)
        sleep_through()

    def late_drive(port: Port, *, opened: bool) -> None:
        if opened:
            sleep_through()
        drive(port, opened=opened)

    with monkeypatch.context() as patch:
        if stopped == "after it":
            patch.setattr(Port, "drive", late_drive)
        else:
            patch.setattr(watchdog.Guardian, "arm", late_arm)
        with pytest.raises(ExposureError, match=r"not opened in the time .* it lasted 0\.2 s"):
            box.open()
    box.disconnect()
    while select.select([pty.near], [], [], 0.0)[0]:
        box_heard.append(os.read(pty.near, 1))
    assert b"".join(box_heard[:2]) == b"00" and box_heard[-1] == b"0"
    assert box_heard.count(b"1") == (stopped == "after it")
