"""The serial shutter on a fake line: levels, feedback, commands, and every way it can fail."""

from __future__ import annotations

import gc
import itertools
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import serial

from drivers.serial_shutter import SerialShutter
from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.devices import Clock, DriverContext
from pdcd.bench.tables import Config, LimitsConfig, RigConfig, TriggerConfig
from pdcd.errors import ConfigError, DeviceLost, ExposureError
from tests.fake_serial import FakeLine, fake_line

SURE_NS = 100_000_000


def make(clock: Clock, *, port: str = "line://box", **options: Any) -> SerialShutter:
    trigger = TriggerConfig(driver="serial", options={"port": port, **options})
    rig = RigConfig(clock="virtual" if isinstance(clock, VirtualClock) else "real")
    config = Config(trigger=trigger, rig=rig)
    return SerialShutter.create(DriverContext(config=config, clock=clock))


@pytest.fixture
def line() -> Iterator[FakeLine]:
    with fake_line("box", VirtualClock()) as line:
        yield line


Make = Callable[..., SerialShutter]


@pytest.fixture
def shutter(line: FakeLine) -> Iterator[Make]:
    """Makes shutters on the fake line and disconnects them at the end."""
    made: list[SerialShutter] = []

    def one(**options: Any) -> SerialShutter:
        made.append(make(line.clock, **options))
        return made[-1]

    yield one
    line.unplugged, line.cts = False, lambda: False
    for each in made:
        each.disconnect()
    assert not [t for t in threading.enumerate() if isinstance(t, threading.Timer)]


@pytest.mark.parametrize("name", ["rts", "dtr"])
@pytest.mark.parametrize("active_low", [False, True])
def test_only_the_chosen_line_moves_and_only_for_the_exposure(
    line: FakeLine, shutter: Make, name: str, active_low: bool
) -> None:
    box = shutter(release=name, active_low=active_low)
    box.connect()
    other = "dtr" if name == "rts" else "rts"
    assert set(line.levels(name)) == {active_low}  # also while the port was opened
    line.edges.clear()
    box.open()
    assert line.levels(name) == [not active_low]
    box.close()
    assert line.levels(name) == [not active_low, active_low]
    box.disconnect()
    assert line.levels(name)[2:] == [active_low] * len(line.levels(name)[2:])
    assert not any(line.levels(other))


def test_times_are_those_by_which_it_surely_held(line: FakeLine, shutter: Make) -> None:
    box = shutter()
    box.connect()
    before = line.clock.now_ns()
    assert box.open() == before + SURE_NS == line.clock.now_ns()
    assert line.edges[-1].t_ns == before
    before = line.clock.now_ns()
    assert box.close() == before + SURE_NS
    assert box.close() == line.clock.now_ns() == before + SURE_NS  # nothing to wait for


def test_who_waits_for_the_box_shows_that_he_lives(line: FakeLine) -> None:
    """The service's watchdog allows 20 s without a sign: less than some boxes take."""
    clock, signs_ns = line.clock, [line.clock.now_ns()]
    trigger = TriggerConfig(
        driver="serial",
        lag_s=15.0,
        jitter_s=0.0,
        options={"port": "line://box", "ready_s": 60.0, "feedback": "cts", "answer_s": 10.0},
    )

    def alive() -> None:
        signs_ns.append(clock.now_ns())

    context = DriverContext(config=Config(trigger=trigger), clock=clock, alive=alive)
    box = SerialShutter.create(context)
    box.connect()
    line.cts = lambda: clock.now_ns() > line.edges[-1].t_ns + 8e9 and line.levels("rts")[-1]
    box.open()
    box.close()
    signs_ns.append(clock.now_ns())
    box.disconnect()
    assert signs_ns[-1] - signs_ns[0] > 80e9
    assert max(b - a for a, b in itertools.pairwise(signs_ns)) < 3e9


# Feedback.


def wire_feedback(line: FakeLine, *, delay_s: float, invert: bool = False) -> None:
    """The shutter's contact on CTS, `delay_s` behind RTS."""

    def contact() -> bool:
        past = line.clock.now_ns() - round(delay_s * 1e9)
        before = [e.level for e in line.edges if e.line == "rts" and e.t_ns <= past]
        return (before[-1] if before else False) != invert

    line.cts = contact


@pytest.mark.parametrize("invert", [False, True])
def test_open_returns_when_the_feedback_says_so(
    line: FakeLine, shutter: Make, invert: bool
) -> None:
    """It is looked at every millisecond."""
    wire_feedback(line, delay_s=0.0333, invert=invert)
    box = shutter(feedback="cts", feedback_active_low=invert)
    box.connect()
    line.clock.sleep_until_ns(line.clock.now_ns() + 10**9)
    asked_ns = line.clock.now_ns()
    assert box.open() == asked_ns + 34_000_000 == line.clock.now_ns()
    asked_ns = line.clock.now_ns()
    assert box.close() >= asked_ns + round(0.0333e9) + SURE_NS
    box.disconnect()


@pytest.mark.parametrize(("feedback", "other"), [("cts", "dsr"), ("dsr", "cts")])
def test_a_shutter_that_does_not_open_is_an_error_and_released(
    line: FakeLine, shutter: Make, feedback: str, other: str
) -> None:
    """The other input says that it did, and does not count."""
    setattr(line, other, lambda: True)
    box = shutter(feedback=feedback, answer_s=0.5)
    box.connect()
    asked_ns = line.clock.now_ns()
    words = rf"{feedback.upper()} does not say that the shutter did open.*0\.5 s after"
    with pytest.raises(ExposureError, match=words):
        box.open()
    assert line.clock.now_ns() == asked_ns + 500_000_000 + SURE_NS  # then it is let go
    assert line.levels("rts")[-1] is False


def test_a_shutter_that_stays_open_is_an_error_every_time_it_is_looked_at(
    line: FakeLine, shutter: Make
) -> None:
    box = shutter(feedback="cts", answer_s=0.1)
    wire_feedback(line, delay_s=0.0)
    box.connect()
    box.open()
    line.cts = lambda: True
    for _ in range(2):
        with pytest.raises(ExposureError, match="did close"):
            box.close()
    line.cts = lambda: False
    box.close()


# Commands.

BOX = {"release": "command", "open_hex": "FF 01 01", "close_hex": "FF 01 00"}

REPLIES = {"open_reply_hex": "4F", "close_reply_hex": "43 0A"}


def test_a_wrong_reply_is_an_error_and_the_box_is_told_to_close(
    line: FakeLine, shutter: Make
) -> None:
    """Of several faults of an opening the first is told."""
    line.answer = lambda sent: b"C\n"
    box = shutter(**BOX, **REPLIES)
    box.connect()
    line.answer = lambda sent: b"?!"
    with pytest.raises(ExposureError, match=r"answered 3f to FF 01 01, not 4F"):
        box.open()
    assert line.received[-2:] == [b"\xff\x01\x01", b"\xff\x01\x00"]
    line.answer = lambda sent: b"C\n"


def test_a_box_that_says_nothing_is_lost(line: FakeLine, shutter: Make) -> None:
    box = shutter(**BOX, **REPLIES, answer_s=0.05)
    with pytest.raises(DeviceLost, match=r"no reply to FF 01 00 within 0.05 s"):
        box.connect()


def test_a_box_gets_the_time_it_needs_to_start(line: FakeLine, shutter: Make) -> None:
    before = line.clock.now_ns()
    shutter(**BOX, ready_s=2.0).connect()
    assert line.clock.now_ns() == before + 2 * 10**9


# What can go wrong.


def test_unplugged_during_an_exposure_is_never_called_closed(line: FakeLine, shutter: Make) -> None:
    box = shutter()
    box.connect()
    box.open()
    line.unplugged = True
    for _ in range(3):
        with pytest.raises(DeviceLost, match="unplugged"):
            box.close()
    line.unplugged = False
    box.connect()  # back again: opened anew and closed
    assert line.levels("rts")[-1] is False
    assert box.open()


@pytest.mark.parametrize("longest_s", [100.0, float("inf")])
def test_an_exposure_of_any_length_is_guarded_by_a_time_that_can_be_waited_for(
    line: FakeLine, longest_s: float
) -> None:
    """Half a minute longer than the longest exposure."""
    trigger = TriggerConfig(options={"port": "line://box"})
    config = Config(trigger=trigger, limits=LimitsConfig(max_exposure_s=longest_s))
    box = SerialShutter.create(DriverContext(config=config, clock=line.clock))
    box.connect()
    box.open()
    (alarm,) = (t for t in threading.enumerate() if isinstance(t, threading.Timer))
    alarm.join(0.05)
    assert alarm.is_alive()
    assert longest_s > 100.0 or alarm.interval == 130.0
    box.disconnect()


@pytest.mark.parametrize("unplugged", [False, True])
def test_a_shutter_that_is_forgotten_is_closed(
    line: FakeLine, caplog: pytest.LogCaptureFixture, unplugged: bool
) -> None:
    """No guardian holds such a port: the line would stay as it is."""
    with warnings.catch_warnings(action="ignore", category=ResourceWarning):
        gc.collect()  # what other tests left behind is not told of here
    box = make(line.clock)
    box.connect()
    box.open()
    line.unplugged = unplugged
    del box
    gc.collect()
    assert line.levels("rts")[-1] is unplugged
    assert ("may be open" in caplog.text) is unplugged
    assert not [t for t in threading.enumerate() if isinstance(t, threading.Timer)]


def test_a_port_that_is_not_there(line: FakeLine) -> None:
    with pytest.raises(DeviceLost, match=r"cannot open line://none.*by-id"):
        make(VirtualClock(), port="line://none").connect()
    with pytest.raises(DeviceLost, match=r"cannot open /dev/none.*plugged in"):
        make(RealClock(), port="/dev/none").connect()
    with pytest.raises(DeviceLost, match="is it a serial port"):
        make(RealClock(), port="/dev/null").connect()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "port"),
        ({"port": "loop://", "relese": "rts"}, "relese"),
        ({"port": "loop://", "release": "ring"}, "ring"),
        ({"port": "loop://", **BOX, "close_hex": "ff0101"}, "must differ"),
        ({"port": "loop://", **BOX, "close_hex": "xyz"}, "hex"),
        ({"port": "loop://", **BOX, "open_hex": " "}, "needs open_hex and close_hex"),
        ({"port": "loop://", "release": "command", "open_hex": "31"}, "needs open_hex and close"),
        ({"port": "loop://", "release": "command", "close_hex": "30"}, "needs open_hex and close"),
        ({"port": "loop://", "open_hex": "01"}, "release = 'command'"),
        ({"port": "loop://", "close_hex": "01"}, "release = 'command'"),
        ({"port": "loop://", "open_reply_hex": "01"}, "release = 'command'"),
        ({"port": "loop://", "limit_s": float("inf")}, "limit_s"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], message: str) -> None:
    config = Config(trigger=TriggerConfig(options=options))
    with pytest.raises(ConfigError, match=message):
        SerialShutter.create(DriverContext(config=config, clock=VirtualClock()))


def test_a_real_port_needs_a_real_clock() -> None:
    with pytest.raises(ConfigError, match=r"rig\.clock"):
        make(VirtualClock(), port="/dev/ttyUSB0")


@pytest.mark.parametrize(("release", "feedback"), [("rts", "cts"), ("dtr", "dsr")])
def test_pyserials_own_loop_feeds_the_line_back(release: str, feedback: str) -> None:
    box = make(VirtualClock(), port="loop://", release=release, feedback=feedback)
    box.connect()
    before = box._clock.now_ns()
    assert box.open() == before
    box.close()
    box.disconnect()


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


def test_a_second_connect_closes_the_shutter_on_the_same_port(
    line: FakeLine, shutter: Make
) -> None:
    box = shutter()
    for _ in range(3):
        box.connect()
        box.open()
    box.connect()
    assert line.levels("rts")[-1] is False and line.opened == 1
    box.disconnect()
    box.connect()
    assert line.opened == 2


def test_a_port_whose_shutter_does_not_close_is_given_back(
    line: FakeLine, shutter: Make, ports: list[serial.Serial]
) -> None:
    """Its feedback says at the start that it is open."""
    line.cts = lambda: True
    box = shutter(feedback="cts", answer_s=0.01)
    with pytest.raises(ExposureError, match="polarity"):
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


def test_replies_are_waited_for_and_what_came_before_is_none(line: FakeLine, shutter: Make) -> None:
    line.answer = lambda sent: b"Oops" if sent[-1] else b"C\nxyz"
    box = shutter(**BOX, **REPLIES)
    box.connect()
    box.open()
    box.close()
    assert line.received == [b"\xff\x01\x00", b"\xff\x01\x01", b"\xff\x01\x00"]


def test_the_watchdog_goes_by_the_time_of_the_exposure_up_to_its_limit(
    line: FakeLine, shutter: Make
) -> None:
    box = shutter(limit_s=60.0)
    box.connect()
    released = threading.Event()
    line.on_edge = lambda edge: None if edge.level else released.set()
    box.expect_exposure(0.01, 0.5)
    box.open()
    assert released.wait(30.0)
    with pytest.raises(ExposureError, match=r"watchdog ended the exposure: it lasted 0\.5 s"):
        box.close()
    for longest_s in (None, 1000.0):  # of one nothing is known, of the other too much
        if longest_s is not None:
            box.expect_exposure(2.0, longest_s)
        box.open()
        (alarm,) = (t for t in threading.enumerate() if isinstance(t, threading.Timer))
        assert alarm.interval == 60.0
        box.close()


def test_a_shutter_says_what_it_is_and_what_can_be_said_of_its_port(
    line: FakeLine, shutter: Make
) -> None:
    box = shutter(release="dtr", active_low=True)
    (finding,) = box.look()
    assert (finding.what, finding.state) == ("port", "unknown")
    assert "line://box" in finding.found and line.opened == 0
    assert box.connect() == {
        "model": "serial shutter",
        "port": "line://box",
        "release": "dtr, active low",
        "feedback": "none",
        "watchdog": "alarm",
    }


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
