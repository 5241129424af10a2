"""The serial shutter to the nanosecond, and what it is after something went wrong."""

from __future__ import annotations

import itertools
import os
import select
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import serial

from drivers.serial_shutter import guardian, watchdog
from drivers.serial_shutter.port import Port
from drivers.serial_shutter.shutter import SerialShutter
from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import Config, RigConfig, TriggerConfig
from pdcd.errors import DeviceLost, ExposureError
from tests.fake_serial import FakeLine, fake_line
from tests.processes import LONG_S

MS = 1_000_000
SURE_NS = 100 * MS
"""A lag of 60 ms and four jitters of 10 ms."""

Make = Callable[..., SerialShutter]


@pytest.fixture
def line() -> Iterator[FakeLine]:
    with fake_line("box", VirtualClock()) as line:
        yield line


@pytest.fixture
def shutter(line: FakeLine) -> Iterator[Make]:
    """Makes shutters on the fake line and disconnects them at the end."""
    made: list[SerialShutter] = []

    def one(**options: Any) -> SerialShutter:
        trigger = TriggerConfig(driver="serial", options={"port": "line://box", **options})
        context = DriverContext(config=Config(trigger=trigger), clock=line.clock)
        made.append(SerialShutter.create(context))
        return made[-1]

    yield one
    line.unplugged, line.cts = False, lambda: False
    for each in made:
        each.disconnect()


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> list[serial.Serial]:
    """Every port that pyserial made."""
    made: list[serial.Serial] = []
    real = serial.serial_for_url

    def make(*args: Any, **how: Any) -> serial.Serial:
        made.append(real(*args, **how))
        return made[-1]

    monkeypatch.setattr(serial, "serial_for_url", make)
    return made


def test_a_long_wait_is_cut_into_pieces_of_two_seconds(
    line: FakeLine, shutter: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = [line.clock.now_ns()]
    sleep = line.clock.sleep_until_ns
    monkeypatch.setattr(line.clock, "sleep_until_ns", lambda t: (times.append(t), sleep(t)))  # type: ignore[func-returns-value]
    shutter(ready_s=5.0).connect()
    assert [b - a for a, b in itertools.pairwise(times)] == [2000 * MS, 2000 * MS, 1000 * MS]


@pytest.mark.parametrize(("after_ms", "seen_ms"), [(33.3, 34), (34.0, 34), (34.1, 35), (0, 0)])
def test_the_feedback_is_looked_at_every_millisecond(
    line: FakeLine, shutter: Make, after_ms: float, seen_ms: int
) -> None:
    box = shutter(feedback="cts")
    box.connect()
    asked_ns = line.clock.now_ns()
    line.cts = lambda: line.clock.now_ns() >= asked_ns + round(after_ms * MS)
    assert box.open() == asked_ns + seen_ms * MS == line.clock.now_ns()
    line.cts = lambda: False


def test_the_feedback_has_its_time_and_no_more(line: FakeLine, shutter: Make) -> None:
    box = shutter(feedback="cts", answer_s=0.5)
    box.connect()
    asked_ns = line.clock.now_ns()
    with pytest.raises(ExposureError, match=r"0\.5 s after"):
        box.open()
    assert line.clock.now_ns() == asked_ns + 500 * MS + SURE_NS  # then it is let go


@pytest.mark.parametrize(("feedback", "other"), [("cts", "dsr"), ("dsr", "cts")])
def test_only_the_chosen_input_counts(
    line: FakeLine, shutter: Make, feedback: str, other: str
) -> None:
    setattr(line, other, lambda: True)
    box = shutter(feedback=feedback, answer_s=0.01)
    box.connect()
    with pytest.raises(ExposureError, match="did open"):
        box.open()


def test_a_shutter_says_what_can_be_said_of_its_port_before_it_is_opened(
    line: FakeLine, shutter: Make
) -> None:
    (finding,) = shutter().look()
    assert (finding.what, finding.state) == ("port", "unknown")
    assert "line://box" in finding.found and line.opened == 0
    assert SerialShutter.maturity == "experimental"


def test_the_first_fault_of_an_opening_is_the_one_that_is_told(
    line: FakeLine, shutter: Make
) -> None:
    replies = {"open_reply_hex": "4F", "close_reply_hex": "43"}
    line.answer = lambda sent: b"C"
    box = shutter(release="command", open_hex="31", close_hex="30", **replies)
    box.connect()
    line.answer = lambda sent: b"?"
    with pytest.raises(ExposureError, match="answered 3f to 31, not 4F"):
        box.open()
    assert line.received[-2:] == [b"1", b"0"]  # it was told to close all the same
    line.answer = lambda sent: b"C"


def test_a_second_connect_closes_the_shutter_on_the_same_port(
    line: FakeLine, shutter: Make
) -> None:
    box = shutter()
    box.connect()
    box.open()
    box.connect()
    assert line.levels("rts")[-1] is False
    assert line.opened == 1


def test_a_shutter_that_stays_open_is_no_lost_port(line: FakeLine, shutter: Make) -> None:
    box = shutter(feedback="cts", answer_s=0.01)
    box.connect()
    line.cts = lambda: True
    with pytest.raises(ExposureError, match="did close"):
        box.connect()
    line.cts = lambda: False
    box.connect()
    assert line.opened == 1


def test_what_was_open_when_the_port_was_lost_is_closed_when_it_is_back(
    line: FakeLine, shutter: Make
) -> None:
    box = shutter()
    box.connect()
    box.open()
    line.unplugged = True
    with pytest.raises(DeviceLost):
        box.connect()
    line.unplugged = False
    box.connect()
    assert line.levels("rts")[-1] is False
    before_ns = line.clock.now_ns()
    assert box.close() == before_ns  # there is nothing to wait for
    assert line.opened == 2


def test_a_port_whose_shutter_does_not_close_is_given_back(
    line: FakeLine, shutter: Make, ports: list[serial.Serial]
) -> None:
    line.cts = lambda: True
    box = shutter(feedback="cts", answer_s=0.01)
    with pytest.raises(ExposureError, match="did close"):
        box.connect()
    assert [port.is_open for port in ports] == [False]
    with pytest.raises(DeviceLost, match="connect first"):
        box.open()


@pytest.mark.parametrize("unplugged", [False, True])
def test_a_disconnected_shutter_has_given_its_port_back(
    line: FakeLine, shutter: Make, ports: list[serial.Serial], unplugged: bool
) -> None:
    box = shutter()
    box.connect()
    assert ports[0].is_open
    line.unplugged = unplugged
    if unplugged:
        with pytest.raises(DeviceLost):
            box.disconnect()
    else:
        box.disconnect()
    assert not ports[0].is_open


def test_the_port_is_given_back_even_if_its_watchdog_cannot_be_stopped(
    shutter: Make, ports: list[serial.Serial], monkeypatch: pytest.MonkeyPatch
) -> None:
    box = shutter()
    box.connect()

    def stuck(alarm: watchdog.Alarm) -> None:
        raise RuntimeError("cannot stop")

    monkeypatch.setattr(watchdog.Alarm, "stop", stuck)
    with pytest.raises(RuntimeError, match="cannot stop"):
        box.disconnect()
    assert not ports[0].is_open


def test_a_guardian_has_as_long_for_an_answer_as_the_service_can_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Less than the 20 s after which the daemon itself is taken for dead."""
    bounds: list[float] = []

    class Guard:
        def __init__(self, *_: object, answer_s: float, unguarded: object) -> None:
            bounds.append(answer_s)

        def start(self) -> None:
            bounds.append(-1.0)

    monkeypatch.setattr(watchdog, "ShutterGuard", Guard)
    watchdog.Guardian(7, "rts", "0")
    assert bounds[1:] == [-1.0]  # started at once
    assert 1.0 <= bounds[0] <= 5.0


def test_a_guardian_waits_for_the_rest_of_its_time_and_no_longer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each look takes of the time that is left; what is over is over at once."""
    waits: list[float | None] = []
    now_s = [100.0]
    talk, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    released: list[tuple[int, str, str]] = []

    def waited(reads: list[Any], _w: list[Any], _x: list[Any], wait_s: float | None) -> Any:
        waits.append(wait_s)
        if len(waits) == 4:  # nothing is heard, and the time is over
            return [], [], []
        if len(waits) == 5:
            talk.close()
        now_s[0] += 12.5
        return reads, [], []

    monkeypatch.setattr(select, "select", waited)
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    monkeypatch.setattr(guardian, "release_shutter", lambda *how: released.append(how) or True)  # type: ignore[func-returns-value]
    for word in (b"arm 20", b"look", b"look"):
        talk.send(word)
    guardian.run_serial_guardian(7, "rts", "0", theirs)
    theirs.close()
    assert waits == [None, 20.0, 7.5, 0.0, guardian.AGAIN_S]
    # Nobody said that it is closed before the daemon was gone.
    assert released == [(7, "rts", "0")] * 2


@pytest.mark.parametrize("stopped", ["before the last look", "after it"])
def test_a_daemon_stopped_beyond_the_guardians_time_opens_nothing_unguarded(
    monkeypatch: pytest.MonkeyPatch, stopped: str
) -> None:
    near, far = os.openpty()

    def sleep_through() -> None:
        """As long as the guardian takes to send its command, which closes the shutter."""
        assert select.select([near], [], [], LONG_S)[0]
        box_heard.append(os.read(near, 1))

    box_heard: list[bytes] = []
    arm, drive = watchdog.Guardian.arm, Port.drive
    with monkeypatch.context() as patch:
        options = {"release": "command", "open_hex": "31", "close_hex": "30", "limit_s": 0.2}
        trigger = TriggerConfig(options={"port": os.ttyname(far), **options})
        config = Config(trigger=trigger, rig=RigConfig(clock="real"))
        box = SerialShutter.create(DriverContext(config=config, clock=RealClock()))
        box.connect()
        sleep_through()  # it is closed first of all

        def late_arm(guard: watchdog.Guardian, limit_s: float) -> None:
            arm(guard, limit_s)
            sleep_through()

        def late_drive(port: Port, *, opened: bool) -> None:
            if opened:
                sleep_through()
            drive(port, opened=opened)

        if stopped == "after it":
            patch.setattr(Port, "drive", late_drive)
        else:
            patch.setattr(watchdog.Guardian, "arm", late_arm)
        with pytest.raises(ExposureError, match=r"not opened in the time .* it lasted 0\.2 s"):
            box.open()
    box.disconnect()
    while select.select([near], [], [], 0.0)[0]:
        box_heard.append(os.read(near, 1))
    for end in (near, far):
        os.close(end)
    assert b"".join(box_heard[:2]) == b"00" and box_heard[-1] == b"0"
    assert box_heard.count(b"1") == (stopped == "after it")
