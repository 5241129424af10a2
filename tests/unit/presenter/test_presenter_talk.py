"""What both processes share: memory, messages, a connection to the X server, the panels' phase."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from Xlib import error

from pdcd.errors import ConfigError
from pdcd.presenter import phase, xconnection
from pdcd.presenter.messages import (
    REPLIES,
    REQUESTS,
    Done,
    Failed,
    Play,
    Rect,
    Slot,
    copy_to_shared_memory,
    lay_out_arrays,
    map_shared_arrays,
)
from pdcd.presenter.phase import compare_vblanks, is_from_timer
from pdcd.presenter.xconnection import (
    ServerLost,
    close_x_connection,
    guard_x_calls,
    open_x_connection,
)
from pdcd.presenter.xpresent import KIND_MSC

# Shared memory.


@pytest.mark.parametrize(("size", "following"), [(1, 64), (63, 64), (64, 64), (65, 128)])
def test_each_array_begins_on_a_cache_line(size: int, following: int) -> None:
    arrays: dict[str, Any] = {"a": np.zeros(size, np.uint8), "b": np.zeros((2, 3), np.int32)}
    slots, total = lay_out_arrays(arrays)
    assert slots == [Slot("a", "|u1", (size,), 0), Slot("b", "<i4", (2, 3), following)]
    assert total == following + 64
    assert lay_out_arrays({}) == ([], 64)
    assert lay_out_arrays({"a": np.zeros(0)}) == ([Slot("a", "<f8", (0,), 0)], 64)


def test_shared_arrays_are_one_for_all_who_hold_the_descriptor() -> None:
    arrays: dict[str, Any] = {
        "head": np.arange(5, dtype=np.int64), "rows": np.arange(6, dtype=np.int32).reshape(2, 3),
        "none": np.zeros((0, 4), dtype=np.float32),
    }  # fmt: skip
    fd, slots, mine = copy_to_shared_memory(arrays)
    theirs = map_shared_arrays(fd, slots)
    assert not os.get_inheritable(fd) and os.fstat(fd).st_size == 128
    os.close(fd)
    for name, array in arrays.items():
        np.testing.assert_array_equal(theirs[name], array)
        assert theirs[name].dtype == array.dtype and theirs[name].shape == array.shape
    mine["rows"][1, 2] = 77
    theirs["head"][0] = 88
    assert theirs["rows"][1, 2] == 77 and mine["head"][0] == 88 and arrays["head"][0] == 0


# Messages.


def test_what_is_a_reply_is_no_request() -> None:
    said = Failed("sync", "late", None, True)
    assert REPLIES.decode(REQUESTS.encode(said)) == said
    play = Play([Slot("a", "u1", (1,), 0)], abort=True)
    assert REQUESTS.decode(REPLIES.encode(play)) == play and play.stalls
    with pytest.raises(msgspec.ValidationError):
        REQUESTS.decode(REPLIES.encode(Done()))


# A connection to the X server.


class Knock:
    """A socket that notes where it was connected to; `fault` is raised there."""

    to: list[Any]
    fault: OSError | None = None

    def __init__(self, family: int) -> None:
        assert family == socket.AF_UNIX

    def __enter__(self) -> Knock:
        return self

    def __exit__(self, *unused: object) -> None:
        self.to.append("closed")

    def connect(self, address: str) -> None:
        self.to.append(address)
        if self.fault is not None:
            raise self.fault


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What was opened and where it was knocked; no path of a server is there."""
    found: list[Any] = []
    Knock.to, Knock.fault = found, None

    def display(name: str) -> str:
        print("strange cookies")  # noqa: T201 - as the library does
        found.append(("display", name))
        return f"a display of {name}"

    monkeypatch.setattr(xconnection, "Display", display)
    monkeypatch.setattr(socket, "socket", Knock)
    monkeypatch.setattr(Path, "exists", lambda path: path.name == "X3")
    monkeypatch.delenv("DISPLAY", raising=False)
    return found


@pytest.mark.parametrize(
    ("name", "address"),
    [
        (":7", "\0/tmp/.X11-unix/X7"), (":12.1", "\0/tmp/.X11-unix/X12"),
        ("unix:3", "/tmp/.X11-unix/X3"),
    ],
)  # fmt: skip
def test_a_server_is_knocked_at_before_it_is_opened(
    opened: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    address: str,
) -> None:
    assert open_x_connection(name) == f"a display of {name}"
    assert opened == [address, "closed", ("display", name)]
    # Standard output may be JSON.
    assert capsys.readouterr() == ("", "strange cookies\n")
    monkeypatch.setenv("DISPLAY", name)
    assert open_x_connection() == open_x_connection("") == f"a display of {name}"
    assert open_x_connection(":9") == "a display of :9"


@pytest.mark.parametrize(
    "name", ["host:7", "HDMI-1", ":", "7", ":7.", "tcp:7", ":x", "localhost:10.0"]
)
def test_a_server_of_another_machine_is_refused(opened: list[Any], name: str) -> None:
    with pytest.raises(ConfigError, match=r"is not the name of an X server .*write \":7\""):
        open_x_connection(name)
    with pytest.raises(ConfigError, match=r"DISPLAY is not set \(start pdcd-x\.service"):
        open_x_connection()
    assert opened == []


@pytest.mark.parametrize(
    "fault", [ConnectionRefusedError("refused"), FileNotFoundError("no such file")]
)
def test_a_server_that_nobody_hears_is_lost(opened: list[Any], fault: OSError) -> None:
    Knock.fault = fault
    with pytest.raises(ServerLost, match=r":7 does not answer: .*systemctl status pdcd-x"):
        open_x_connection(":7")
    assert opened[1:] == ["closed"]


@pytest.mark.parametrize(
    ("fault", "raised"),
    [
        (error.DisplayConnectionError(":7", "no"), ServerLost), (OSError("no"), ServerLost),
        (error.ConnectionClosedError("server"), ServerLost), (ValueError("a fault of ours"),
        ValueError),
    ],
)  # fmt: skip
def test_failures_of_the_library_are_our_own_errors(
    opened: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    fault: Exception,
    raised: type[Exception],
) -> None:
    def fail(name: str) -> Any:
        raise fault

    monkeypatch.setattr(xconnection, "Display", fail)
    with pytest.raises(raised):
        open_x_connection(":7")
    if not isinstance(fault, error.DisplayConnectionError):
        with pytest.raises(raised), guard_x_calls(SimpleNamespace(get_display_name=lambda: ":7")):
            raise fault


@pytest.mark.parametrize(
    ("fault", "hidden"),
    [(None, True), (error.ConnectionClosedError("server"), True), (OSError(), True),
     (ValueError(), False)],
)  # fmt: skip
def test_a_connection_is_closed_whatever_its_state(fault: Exception | None, hidden: bool) -> None:
    done: list[str] = []

    def close() -> None:
        done.append("display")
        if fault is not None:
            raise fault

    inner = SimpleNamespace(socket=SimpleNamespace(close=lambda: done.append("socket")))
    display = SimpleNamespace(close=close, display=inner)
    if hidden:
        close_x_connection(display)
        assert done == ["display", "socket"]
    else:
        with pytest.raises(ValueError):
            close_x_connection(display)


# The phase of two outputs.

PERIOD_NS = 16_000_000


class Vblanks:
    """Counts vblanks of one output; `steps` are the numbers asked for."""

    def __init__(self, lag_ns: int = 0, scatter_ns: int = 0, last: int = 10**9) -> None:
        self.ns = self.msc = 0
        self.asked: list[int] = []
        self.waits: list[tuple[int, float]] = []
        self.lag_ns, self.scatter_ns, self.last, self.closed = lag_ns, scatter_ns, last, 0

    def ask(self, msc: int) -> None:
        self.asked.append(msc)
        self.msc = msc or 500

    def wait(self, kind: int, timeout_s: float) -> bool:
        self.waits.append((kind, timeout_s))
        odd = len(self.waits) % 2
        self.ns = 10**12 + self.msc * PERIOD_NS + self.lag_ns + odd * self.scatter_ns
        if len(self.asked) == 1:
            self.ns += 7_000_000  # answered at once, between two vblanks
        return len(self.waits) <= self.last

    def close(self) -> None:
        self.closed += 1


def measured(monkeypatch: pytest.MonkeyPatch, *sources: Vblanks) -> phase.VblankPhase | None:
    """The phase of two outputs, by windows of which nothing else is looked at."""
    waiting = list(sources)
    root = SimpleNamespace(create_window=lambda *place, **how: SimpleNamespace(id=1))
    screen = SimpleNamespace(root=root, root_depth=24)
    display = SimpleNamespace(screen=lambda: screen, sync=lambda: None)
    monkeypatch.setattr(phase, "open_x_connection", lambda name: display)
    monkeypatch.setattr(phase, "close_x_connection", lambda display: None)
    monkeypatch.setattr(phase, "PresentEvents", lambda name, number: waiting.pop(0))
    place = Rect(0, 0, 4, 3)
    return phase.measure_vblank_phase(":7", (place, place))


def test_both_outputs_are_asked_for_every_second_vblank_after_the_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    projector, mask = Vblanks(), Vblanks(3_000_000)
    found = measured(monkeypatch, projector, mask)
    assert found is not None
    assert found.lag_s == pytest.approx(0.003)
    assert found.period_s == pytest.approx((0.016, 0.016))
    wanted = [0, *range(502, 542, 2)]
    assert projector.asked == mask.asked == wanted
    assert set(mask.waits) == {(KIND_MSC, 0.5)}


def test_a_timer_is_told_after_eight_samples_and_silence_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    timer, mask = Vblanks(scatter_ns=400_000), Vblanks()
    assert measured(monkeypatch, timer, mask) is None
    assert len(timer.asked) == 9
    silent = Vblanks(last=3)
    assert measured(monkeypatch, Vblanks(), silent) is None
    assert len(silent.waits) == 4


@pytest.mark.parametrize(("scatter_ns", "screen"), [(190_000, True), (210_000, False)])
def test_a_screens_stamps_scatter_by_less_than_a_tenth_of_a_millisecond(
    scatter_ns: int, screen: bool
) -> None:
    """Every second one late by that, after a line: half of it on both sides."""
    msc = np.arange(40)
    stamps = np.stack([10**12 + msc * PERIOD_NS + msc // 2 % 2 * scatter_ns, msc], axis=1)
    assert is_from_timer(stamps) is not screen
    steady = np.stack([10**12 + msc * PERIOD_NS, msc], axis=1)
    for both in ((stamps, steady), (steady, stamps)):
        assert (compare_vblanks(*both) is not None) is screen
