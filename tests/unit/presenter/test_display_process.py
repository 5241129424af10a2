"""The display process without its windows: what it answers, when it is black, and how it ends."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.child import Codec, LineClosedError, MessageLine
from pdcd.errors import ConfigError, DeviceLost
from pdcd.panels.map import Map
from pdcd.presenter import process
from pdcd.presenter.messages import (
    HEAD_SIZE,
    REPLIES,
    Black,
    DisplayRequest,
    Done,
    Failed,
    Head,
    Load,
    Open,
    PanelMode,
    Play,
    Quit,
    Ready,
    Show,
    copy_to_shared_memory,
)
from pdcd.presenter.options import X11Options
from pdcd.presenter.process import SOURCES, Presenter

PERIOD_NS = 10_000_000

READY = Ready("clock", 100.0, {"renderer": "none"})


class Panels:
    """Stands in for `Presenter`; `made` are all there were."""

    made: list[Panels]
    faults: dict[str, Exception]

    def __init__(self, request: Open, hung_up: Callable[[], bool], driver: int) -> None:
        self.calls: list[object] = []
        self.hung_up, self.driver, self.ready = hung_up, driver, READY
        self._may_fail("open")
        self.made.append(self)

    def _may_fail(self, name: str) -> None:
        if name in self.faults:
            raise self.faults[name]

    def show(self, row: int) -> None:
        self.calls.append(("show", row))
        self._may_fail("show")

    def load(self, message: Load, arrays: Any) -> None:
        self.calls.append(("load", sorted(arrays)))
        self._may_fail("load")

    def play(self, message: Play, arrays: Any) -> None:
        self.calls.append(("play", message.abort))
        arrays["head"][Head.SHOWN] = 7

    def black(self) -> None:
        self.calls.append("black")

    def idle(self) -> None:
        if self.calls[-1:] != ["idle"]:
            self.calls.append("idle")
        self._may_fail("idle")

    def close(self) -> None:
        self.calls.append("close")


@pytest.fixture
def panels(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Panels]]:
    monkeypatch.setattr(process, "Presenter", Panels)
    monkeypatch.setattr(process, "IDLE_S", 0.01)
    Panels.made, Panels.faults = [], {}
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield Panels
    for number, handler in before.items():
        signal.signal(number, handler)


def opening(**options: Any) -> Open:
    mode = PanelMode(Map.filling((8, 8)), 100.0)
    return Open(X11Options(projector="A", mask="B", **options), mode, mode)


class Talk:
    """Both ends of the line; the process's own is closed as its end would close it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.driver, self.its = MessageLine(ends[0], REPLIES), ends[1]
        self.theirs: MessageLine[DisplayRequest] | None = None
        monkeypatch.setattr(MessageLine, "at", self._line)

    def _line(self, fd: int, codec: Codec[DisplayRequest]) -> MessageLine[DisplayRequest]:
        self.theirs = MessageLine(socket.socket(fileno=fd), codec)
        return self.theirs

    def run(self, *requests: DisplayRequest, fd: int | None = None) -> int:
        """Send all requests, and run the process here; a descriptor goes with what needs one."""
        for request in requests:
            self.driver.send(request, fd if isinstance(request, Load | Play) else None)
        return process.run_display_process(self.its.detach())

    def said(self) -> list[Any]:
        found: list[Any] = []
        with suppress(LineClosedError):
            while self.driver.wait(0.0):
                found.append(self.driver.receive())
        return found

    def close(self) -> None:
        for end in (self.driver, self.its, self.theirs):
            if end is not None:
                end.close()


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch, panels: type[Panels]) -> Iterator[Talk]:
    line = Talk(monkeypatch)
    yield line
    line.close()


def test_each_request_is_answered_once_and_the_last_one_closes(
    line: Talk, panels: type[Panels]
) -> None:
    fd, slots, arrays = copy_to_shared_memory({"head": np.zeros(HEAD_SIZE, dtype=np.int64)})
    load = Load(slots, (1, 1), (1, 1), "whole")
    before = len(list(Path("/proc/self/fd").iterdir()))
    status = line.run(
        opening(), load, Play(slots, abort=True), Show(4), Black(), Quit(), Show(5), fd=fd
    )
    assert len(list(Path("/proc/self/fd").iterdir())) == before  # what came along was let go
    os.close(fd)
    assert (status, line.said()) == (0, [READY, *[Done()] * 5])
    (made,) = panels.made
    assert made.calls == [
        ("load", ["head"]), ("play", True), ("show", 4), "black", "black", "close",
    ]  # fmt: skip
    assert arrays["head"][Head.SHOWN] == 7


def test_a_driver_that_is_gone_leaves_black_panels_and_no_error(
    line: Talk, panels: type[Panels], monkeypatch: pytest.MonkeyPatch
) -> None:
    line.driver.send(opening())

    def hang_up(self: Panels) -> None:
        self.calls.append(("gone", self.hung_up()))
        line.driver.close()
        self.calls.append(("gone", self.hung_up()))

    monkeypatch.setattr(panels, "idle", hang_up)
    assert process.run_display_process(line.its.detach()) == 0
    assert panels.made[0].calls == [("gone", False), ("gone", True), "close"]


def test_signals_of_a_terminal_or_a_service_are_not_for_it(
    line: Talk, panels: type[Panels]
) -> None:
    line.run(opening(), Quit())
    for number in (signal.SIGINT, signal.SIGTERM):
        assert signal.getsignal(number) is signal.SIG_IGN


def test_windows_and_outputs_are_looked_at_while_nothing_is_asked(
    line: Talk, panels: type[Panels]
) -> None:
    panels.faults["idle"] = DeviceLost("HDMI-1 is gone", device="display", hint="plug it in")
    status = line.run(opening())
    said = line.said()
    assert (status, said[0], panels.made[0].calls) == (1, READY, ["idle", "close"])
    assert said[1:] == [Failed("device_lost", "HDMI-1 is gone", "plug it in", False)]


FAULTS = [
    (DeviceLost("gone", device="mask", hint="h"), Failed("device_lost", "mask: gone", "h", False)),
    (DeviceLost("gone"), Failed("device_lost", "gone", None, False)),
    (RuntimeError("odd"), Failed("device_lost", "RuntimeError: odd", None, False)),
]


@pytest.mark.parametrize(("error", "said"), FAULTS)
@pytest.mark.parametrize("at", ["open", "show"])
def test_an_error_is_told_after_the_panels_were_closed(
    line: Talk, panels: type[Panels], at: str, error: Exception, said: Failed
) -> None:
    panels.faults[at] = error
    status = line.run(opening(), Show(3), Show(4))
    answers = line.said()
    assert status == 1
    assert answers == ([] if at == "open" else [READY]) + [said]
    assert [made.calls for made in panels.made] == (
        [] if at == "open" else [[("show", 3), "close"]]
    )


def test_patterns_that_are_refused_are_no_end(line: Talk, panels: type[Panels]) -> None:
    panels.faults["show"] = ConfigError("no such row", device="display", hint="fewer")
    status = line.run(opening(), Show(3), Black(), Quit())
    said = line.said()
    assert (status, said) == (
        0, [READY, Failed("config", "no such row", "fewer", True), Done(), Done()]
    )  # fmt: skip
    assert panels.made[0].calls == [("show", 3), "black", "black", "close"]


def test_nothing_is_shown_before_the_panels_are_open(line: Talk, panels: type[Panels]) -> None:
    status = line.run(Show(1))
    (said,) = line.said()
    assert (status, said.kind, said.alive) == (1, "device_lost", False)
    assert "not open" in said.message and panels.made == []


def test_a_failure_that_nobody_hears_is_logged(
    line: Talk,
    panels: type[Panels],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    line.driver.send(opening())

    def lose(self: Panels) -> None:
        line.driver.close()
        raise DeviceLost("the mask is gone")

    monkeypatch.setattr(panels, "idle", lose)
    assert process.run_display_process(line.its.detach()) == 1
    assert "nobody is left to be told" in caplog.text and "the mask is gone" in caplog.text


# Which source of time is taken.


def chooser(asked: str) -> Presenter:
    made = Presenter.__new__(Presenter)
    windows = SimpleNamespace(swap=lambda: None, finish=lambda: None, draw_black=lambda: None)
    made._windows, made._events = windows, None  # type: ignore[assignment]
    made._options = X11Options(projector="A", mask="B", time_source=asked)  # type: ignore[arg-type]
    return made


def probing(monkeypatch: pytest.MonkeyPatch, delivers: Callable[[str, int], bool]) -> list[str]:
    """`delivers(name, n)`: whether that source does when it is the n-th time that one is asked."""
    asked: list[str] = []

    def probe(source: Any, frame: Callable[[], None], nominal_ns: float) -> float | None:
        asked.append(source.name)
        return nominal_ns + 1.0 if delivers(source.name, len(asked)) else None

    monkeypatch.setattr(process, "measure_period_ns", probe)
    return asked


@pytest.mark.parametrize("best", SOURCES)
def test_the_best_source_that_delivers_is_taken(monkeypatch: pytest.MonkeyPatch, best: str) -> None:
    asked = probing(monkeypatch, lambda name, _: name == best)
    source, period_ns = chooser("auto")._find_source(float(PERIOD_NS))
    assert (source.name, period_ns) == (best, PERIOD_NS + 1.0)
    assert tuple(asked) == SOURCES[: SOURCES.index(best) + 1]


def test_where_no_source_delivers_each_was_asked_five_times(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = probing(monkeypatch, lambda *_: False)
    with pytest.raises(DeviceLost, match=r"no vblank at 100\.000 Hz from the .* 'auto'"):
        chooser("auto")._find_source(float(PERIOD_NS))
    assert tuple(asked) == 5 * SOURCES


def test_the_source_that_was_asked_for_is_the_only_one_and_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = probing(monkeypatch, lambda _, count: count == 5)
    source, _ = chooser("swap")._find_source(float(PERIOD_NS))
    assert source.name == "swap" and asked == ["swap"] * 5


def test_a_source_without_pace_is_not_probed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = probing(monkeypatch, lambda *_: False)
    source, period_ns = chooser("free")._find_source(float(PERIOD_NS))
    assert (source.name, period_ns, asked) == ("free", PERIOD_NS, [])
