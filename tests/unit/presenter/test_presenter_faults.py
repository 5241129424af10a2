"""Faults of our own are not taken for a device's, and waiting has its lengths."""

from __future__ import annotations

import ctypes
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import glfw
import pytest

from pdcd.child import LineClosedError
from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter import clocks, process, realtime
from pdcd.presenter.clocks import Completions, Vblanks
from pdcd.presenter.messages import Failed, Quit


def fail(*unused: Any) -> Any:
    raise ZeroDivisionError


class Even:
    """A source that fails as it is told to."""

    name, queues, ns, msc, flipped = "even", False, 0, 0, 0

    def __init__(self, fault: Exception) -> None:
        self.fault = fault

    def sync(self) -> None: ...

    def put(self) -> None: ...

    def shown(self) -> None:
        raise self.fault


def test_only_a_lost_device_is_a_source_that_does_not_deliver() -> None:
    assert clocks.measure_period_ns(Even(DeviceLost("late")), lambda: None, 1e7) is None
    for fault in (ZeroDivisionError(), ConfigError("odd")):
        with pytest.raises(type(fault)):
            clocks.measure_period_ns(Even(fault), lambda: None, 1e7)
    with pytest.raises(ZeroDivisionError):
        clocks.measure_period_ns(Even(DeviceLost("late")), fail, 1e7)


def test_faults_of_our_own_are_not_told_as_a_missing_display(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(glfw, "ERROR_REPORTING", "warn")
    monkeypatch.setattr(glfw, "init", fail)
    with pytest.raises(ZeroDivisionError):
        process._start_glfw(":7")
    monkeypatch.setattr(Path, "iterdir", fail)
    with pytest.raises(ZeroDivisionError):
        realtime.raise_priority(7)


@pytest.mark.parametrize(("refused", "said"), [(0, "yes"), (-1, "no: ")])
def test_pages_are_locked_that_are_there_and_that_come_once_they_are_touched(
    monkeypatch: pytest.MonkeyPatch, refused: int, said: str
) -> None:
    """MCL_CURRENT, MCL_FUTURE and MCL_ONFAULT of sys/mman.h."""
    asked: list[Any] = []

    def lock(flags: int) -> int:
        asked.append(flags)
        return refused

    def library(name: str | None, use_errno: bool = False) -> Any:
        asked.append((name, use_errno))
        return SimpleNamespace(mlockall=lock)

    monkeypatch.setattr(ctypes, "CDLL", library)
    assert realtime.lock_memory().startswith(said)
    assert asked == [(None, True), 1 | 2 | 4]


def test_the_process_looks_at_its_windows_four_times_a_second() -> None:
    waits_s: list[float] = []

    def wait(within_s: float) -> bool:
        waits_s.append(within_s)
        return len(waits_s) == 3

    said: list[Any] = []
    receive = lambda: (Quit(), None)  # noqa: E731
    with socket.socket() as end:
        line: Any = SimpleNamespace(
            fileno=end.fileno, wait=wait, receive_with_fd=receive, send=said.append
        )
        with pytest.raises(DeviceLost, match="the panels are not open"):
            process.serve_display(line)
    assert waits_s == [0.25] * 3 and said == []


def test_a_fault_while_it_is_told_is_no_loss_of_the_driver() -> None:
    told = Failed("device_lost", "gone", None, False)
    for fault, quiet in ((LineClosedError(), True), (ValueError(), False)):

        def send(message: Any, fault: Exception = fault) -> None:
            assert message == told
            raise fault

        line: Any = SimpleNamespace(send=send)
        if quiet:
            assert process._report(line, told) == 1
        else:
            with pytest.raises(ValueError):
                process._report(line, told)
    sent: list[Any] = []
    assert process._report(SimpleNamespace(send=sent.append), told) == 1  # type: ignore[arg-type]
    assert sent == [told]


def test_a_source_waits_half_a_second_for_what_must_come() -> None:
    waits_s: list[float] = []

    def wait(kind: int, timeout_s: float) -> bool:
        waits_s.append(timeout_s)
        return False

    events: Any = SimpleNamespace(wait=wait, ask=lambda msc: None, ns=0, msc=0, flipped=0)
    reported = Completions(events, lambda: None)
    reported.sync()
    with pytest.raises(DeviceLost):
        reported.shown()
    with pytest.raises(DeviceLost):
        Vblanks(events, lambda: None, lambda: None, 1e7).sync()
    assert waits_s == [0.05, 0.5, 0.5]
