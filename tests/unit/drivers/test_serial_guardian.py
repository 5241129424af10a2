"""Who releases the shutter line in the driver's place: the guardian's talk, the alarm, and what is
said of a port that nobody has opened."""

from __future__ import annotations

import fcntl
import grp
import os
import select
import socket
import struct
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.guard import FROZEN_S
from drivers.serial_shutter import guardian, look, watchdog
from pdcd.errors import ConfigError, DeviceLost
from tests.processes import LONG_S, soon


class Served:
    """A guardian in a thread of this process; `released` is how often it closed the shutter."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.released: list[tuple[int, str, str]] = []
        self.takes = True
        monkeypatch.setattr(guardian, "release_shutter", self._release)
        monkeypatch.setattr(guardian, "AGAIN_S", 600.0)
        self.talk, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.talk.settimeout(LONG_S)
        self.theirs = theirs
        self.thread = threading.Thread(
            target=guardian.run_serial_guardian, args=(7, "dtr", "1", theirs), daemon=True
        )
        self.thread.start()

    def _release(self, port: int, how: str, value: str) -> bool:
        self.released.append((port, how, value))
        return self.takes

    def ask(self, word: str) -> bytes:
        self.talk.send(word.encode())
        return self.talk.recv(64)

    def say(self, *words: str) -> list[bytes]:
        return [self.ask(word) for word in words]

    def fires(self) -> None:
        """By the time it was armed for, however often it is looked at meanwhile."""
        before = len(self.released)
        assert self.ask("arm 0.05") == b"ok"
        assert soon(lambda: self.ask("look") != b"" and len(self.released) == before + 1)

    def hang_up(self) -> None:
        self.talk.close()
        self.thread.join(LONG_S)
        assert not self.thread.is_alive()
        self.theirs.close()


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    served = Served(monkeypatch)
    yield served
    served.hang_up()


@pytest.mark.parametrize(
    ("words", "released"),
    [
        (["look"], 0),
        (["arm 600", "look"], 1),  # a look disarms nobody
        (["arm 600", "disarm"], 0),
    ],
)
def test_an_armed_guardian_whose_daemon_is_gone_closes_the_shutter_once(
    served: Served, words: list[str], released: int
) -> None:
    """Also one that died with an answer unread: the kernel then says ECONNRESET, not the end."""
    assert served.say(*words) == [b"ok"] * len(words)
    served.talk.send(b"look")
    assert select.select([served.talk], [], [], LONG_S)[0]
    served.hang_up()
    assert served.released == [(7, "dtr", "1")] * released


def test_a_daemon_that_says_nothing_while_the_shutter_is_open_is_frozen(
    monkeypatch: pytest.MonkeyPatch, served: Served
) -> None:
    assert guardian._FROZEN_S == FROZEN_S
    monkeypatch.setattr(guardian, "_FROZEN_S", 0.1)
    assert served.say("arm 600", "disarm") == [b"ok", b"ok"]
    time.sleep(0.3)
    assert served.released == []
    assert served.ask("arm 600") == b"ok"
    assert soon(lambda: len(served.released) == 1)
    assert served.say("look", "disarm", "look") == [b"silent", b"silent", b"ok"]


@pytest.mark.parametrize(("takes", "said"), [(True, b"fired"), (False, b"lost")])
def test_what_a_guardian_did_is_told_until_the_shutter_is_known_to_be_closed(
    served: Served, takes: bool, said: bytes
) -> None:
    served.takes = takes
    served.fires()
    assert served.say("look", "look", "disarm", "look", "disarm") == [said] * 3 + [b"ok"] * 2
    served.fires()
    assert served.say("arm 600", "look", "disarm") == [b"ok"] * 3
    assert len(served.released) == 2


def test_a_port_is_told_again_until_somebody_says_that_the_shutter_is_closed(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guardian, "AGAIN_S", 0.01)
    served.takes = False
    served.ask("arm 0.01")
    assert soon(lambda: len(served.released) >= 4) and served.ask("look") == b"lost"
    served.takes = True
    assert soon(lambda: served.ask("look") == b"fired")
    # A daemon that was stopped may send its command to open only now.
    closed = len(served.released)
    assert soon(lambda: len(served.released) >= closed + 2)
    assert served.say("look", "disarm") == [b"fired"] * 2
    closed = len(served.released)
    served.hang_up()
    assert len(served.released) == closed > 6


@pytest.mark.parametrize("last", ["look", "disarm"])
def test_a_port_that_did_not_take_it_is_told_once_more_when_the_daemon_ends(
    served: Served, last: str
) -> None:
    served.takes = False
    served.fires()
    assert served.ask(last) == b"lost"
    served.hang_up()
    assert len(served.released) == 1 + (last == "look")


@pytest.mark.parametrize("full_first", [False, True])
def test_a_command_of_which_a_port_takes_a_part_is_sent_to_its_end(
    monkeypatch: pytest.MonkeyPatch, full_first: bool
) -> None:
    """A port to which the daemon has sent much has little room left, or none for a while."""
    port, box = socket.socketpair()
    write = os.write
    full = [full_first]

    def one_byte(fd: int, data: bytes) -> int:
        if full.pop():
            full.append(False)
            raise BlockingIOError(11, "Resource temporarily unavailable")
        full.append(full_first)
        return write(fd, data[:1])

    with port, box:
        monkeypatch.setattr(os, "write", one_byte)
        assert guardian.release_shutter(port.fileno(), "command", "ff00") is True
        assert box.recv(64) == b"\xff\x00"


@pytest.mark.parametrize(("failures", "taken"), [(0, True), (1, True), (2, True), (3, False)])
@pytest.mark.parametrize(
    ("how", "value", "expected"),
    [
        ("command", "ff0100", b"\xff\x01\x00"),
        ("rts", "0", (termios.TIOCMBIC, termios.TIOCM_RTS)),
        ("dtr", "1", (termios.TIOCMBIS, termios.TIOCM_DTR)),
    ],
)
def test_a_port_that_refuses_is_asked_three_times(
    monkeypatch: pytest.MonkeyPatch,
    how: str,
    value: str,
    expected: object,
    failures: int,
    taken: bool,
) -> None:
    calls: list[object] = []

    def asked(port: int, what: object) -> None:
        assert port == 7
        calls.append(what)
        if len(calls) <= failures:
            raise OSError(5, "Input/output error")

    def ioctl(fd: int, request: int, bits: bytes) -> None:
        asked(fd, (request, *struct.unpack("I", bits)))

    def write(port: int, data: bytes) -> int:
        asked(port, data)
        return len(data)

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    monkeypatch.setattr(os, "write", write)
    done = guardian.release_shutter(7, how, value)
    monkeypatch.undo()
    assert done == taken
    assert calls == [expected] * min(failures + 1, 3)


# The two watchdogs of the driver.


class Guarded:
    """What a `ShutterGuard` is told; `answer` is what it hears."""

    def __init__(self, command: Any, *inherits: int, answer_s: float, unguarded: Any) -> None:
        self.command, self.inherits, self.unguarded = command, inherits, unguarded
        self.word: Callable[[], str] = str
        self.answer = b"ok"
        self.looked, self.pid = 0, 5

    def start(self) -> None: ...

    def arm(self, word: Callable[[], str]) -> None:
        self.word = word

    def disarm(self) -> bytes:
        return self.answer

    def ask(self, word: str) -> bytes:
        return self.answer

    def look(self) -> bool:
        self.looked += 1
        return True


@pytest.fixture
def guarded(monkeypatch: pytest.MonkeyPatch) -> tuple[watchdog.Guardian, Guarded]:
    monkeypatch.setattr(watchdog, "ShutterGuard", Guarded)
    made = watchdog.Guardian(7, "rts", "0")
    assert isinstance(made._guard, Guarded)
    return made, made._guard


def test_a_guardian_gets_the_port_and_is_armed_for_what_is_left(
    guarded: tuple[watchdog.Guardian, Guarded], monkeypatch: pytest.MonkeyPatch
) -> None:
    made, guard = guarded
    monkeypatch.setattr(time, "monotonic", lambda: 100.0)
    assert guard.command[-3:] == ("7", "rts", "0") and guard.inherits == (7,)
    made.arm(30.0)
    left = []
    for now_s in (100.0, 112.5, 130.0, 150.0):
        monkeypatch.setattr(time, "monotonic", lambda now_s=now_s: now_s)
        verb, seconds = guard.word().split()
        left.append((verb, float(seconds)))
    assert left == [("arm", 30.0), ("arm", 17.5), ("arm", 0.0), ("arm", 0.0)]


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (b"ok", ""),
        (b"", ""),
        (b"fired", "it lasted 30 s"),
        (b"lost", "it lasted 30 s"),
        (b"silent", "nothing was heard of the daemon for 10 s"),
    ],
)
def test_a_guardian_that_fired_ended_the_exposure(
    guarded: tuple[watchdog.Guardian, Guarded], answer: bytes, why: str
) -> None:
    made, guard = guarded
    made.arm(30.0)
    guard.answer = answer
    assert made.ended() == made.disarm() == why
    assert guard.looked == (not answer)  # which replaces it


@pytest.mark.parametrize("error", [None, DeviceLost("gone"), ConfigError("no modem lines")])
def test_an_alarm_ends_an_exposure_and_says_so_once(
    error: Exception | None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """One that is not heard rings again."""
    monkeypatch.setattr(watchdog, "AGAIN_S", 0.01)
    failures, rung = [error] * 3 if error else [], threading.Event()

    def ring() -> None:
        if failures:
            raise failures.pop()
        rung.set()

    made = watchdog.Alarm(ring)
    made.arm(0.01)
    assert rung.wait(LONG_S)
    assert [made.disarm(), made.disarm()] == ["it lasted 0.01 s", ""]
    assert ("cannot release" in caplog.text) == (error is not None)


@pytest.mark.parametrize("end", [watchdog.Alarm.disarm, watchdog.Alarm.stop])
def test_an_alarm_in_time_leaves_nothing_behind(end: Callable[[watchdog.Alarm], object]) -> None:
    rung = threading.Event()
    made = watchdog.Alarm(rung.set)
    made.arm(0.0)
    assert rung.wait(LONG_S)
    for _ in range(2):
        made.arm(600.0)  # that it rang in the exposure before is not heard in this one
        (timer,) = (t for t in threading.enumerate() if isinstance(t, threading.Timer))
        assert timer.daemon  # a program that ends does not wait for it
    assert end(made) in ("", None)
    assert not any(isinstance(t, threading.Timer) for t in threading.enumerate())


# A port that nobody has opened.


def found(port: str) -> tuple[str, str, str | None]:
    ((part, verdict, words, hint),) = (
        (finding.what, finding.state, finding.found, finding.hint)
        for finding in look.inspect_port(port)
    )
    assert part == "port"
    return verdict, words, hint


@pytest.fixture
def dev(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """What /dev holds."""

    def here(path: str) -> Path:
        return tmp_path if path == "/dev" else Path(path)

    monkeypatch.setattr(look, "Path", here)
    return tmp_path


def test_a_port_is_good_under_its_name_and_under_another(tmp_path: Path) -> None:
    assert found("/dev/null") == ("good", "/dev/null", None)
    alias = tmp_path / "pdcd-trigger"
    alias.symlink_to("/dev/null")
    assert found(str(alias)) == ("good", f"{alias}, which is /dev/null", None)


@pytest.mark.parametrize(("mode", "group"), [(os.R_OK, "dialout"), (os.W_OK, None), (6, "dialout")])
def test_a_port_has_to_be_read_and_written(
    monkeypatch: pytest.MonkeyPatch, mode: int, group: str | None
) -> None:
    def name_of(gid: int) -> SimpleNamespace:
        if group is None:
            raise KeyError(gid)
        return SimpleNamespace(gr_name=group)

    monkeypatch.setattr(os, "access", lambda path, wanted: wanted & mode == wanted)
    monkeypatch.setattr(grp, "getgrgid", name_of)
    verdict, words, hint = found("/dev/null")
    if mode == os.R_OK | os.W_OK:
        assert (verdict, hint) == ("good", None)
    else:
        owner = group or str(Path("/dev/null").stat().st_gid)
        assert (verdict, words) == ("fault", "/dev/null may not be read and written by this user")
        assert hint == f"add the user to the group {owner}, which owns the port"


def test_what_is_no_port_is_told_with_its_reason(dev: Path) -> None:
    (dev / "notes").touch()
    for port, why in (
        (str(dev / "notes"), f"{dev / 'notes'} is no device"),
        (str(dev / "ttyUSB0"), f"{dev / 'ttyUSB0'}: No such file or directory"),
        ("/dev/a\0b", "/dev/a\0b: embedded null byte"),
    ):
        verdict, words, hint = found(port)
        # Newer Pythons say it in other words.
        said = words.replace("stat: embedded null character in path", "embedded null byte")
        assert (verdict, said) == ("fault", why)
        assert hint == "is it plugged in? this machine has no serial port at all"


@pytest.mark.parametrize("count", [1, 6, 9])
def test_other_ports_are_named_up_to_six(dev: Path, count: int) -> None:
    names = [str(dev / f"ttyUSB{number}") for number in range(count)]
    for name in names:
        Path(name).touch()
    _, _, hint = found(str(dev / "pdcd-trigger"))
    more = f" and {count - 6} more" if count > 6 else ""
    assert hint == f"is it plugged in? there are {', '.join(names[:6])}{more}"


@pytest.mark.parametrize("takes", [True, False])
def test_an_exposure_that_nobody_guards_is_ended_and_said_once(
    guarded: tuple[watchdog.Guardian, Guarded], monkeypatch: pytest.MonkeyPatch, takes: bool
) -> None:
    made, guard = guarded
    asked: list[object] = []
    monkeypatch.setattr(watchdog, "release_shutter", lambda *how: asked.append(how) or takes)  # type: ignore[func-returns-value]
    made.arm(30.0)
    if takes:
        guard.unguarded("no process is left")
    else:  # it is asked again then
        with pytest.raises(DeviceLost, match="does not take it"):
            guard.unguarded("no process is left")
    assert asked == [(7, "rts", "0")]
    assert [made.disarm(), made.disarm()] == ["no process is left", ""]
    with suppress(DeviceLost):
        guard.unguarded("no process is left")
    made.arm(30.0)  # the next exposure is not the last one
    assert made.disarm() == ""
