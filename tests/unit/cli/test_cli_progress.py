"""Progress of a capture: a bar on a terminal, a line a second in a pipe."""

from __future__ import annotations

import io
import sys

import pytest

from pdcd.api.progress import bar
from pdcd.protocol.events import Decoded, Decoding, Progress
from tests.unit.cli.cli_stubs import EVENTS


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    return terminal


def test_progress_lines_come_again_after_a_second(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 100.0
    monkeypatch.setattr("pdcd.api.progress.time.monotonic", lambda: now_s)
    with bar() as on_event:
        for now_s in (100.0, 100.9, 101.0, 101.5, 102.1):
            on_event(Progress(shot="coded", frame=round(now_s * 10), frames=2400, missed=3))
    assert capsys.readouterr().err.splitlines() == [
        f"coded: {frame}/2400 refreshes, 3 missed{left}"
        for frame, left in ((1000, ""), (1010, ", 1 s left"), (1021, ", 3 s left"))
    ]


def test_progress_is_a_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = on_terminal(monkeypatch)
    with bar() as on_event:
        on_event(EVENTS[0])
        on_event(EVENTS[2])
    assert "coded: 24/24 refreshes, 3 missed" in screen.getvalue()
    assert "100%" in screen.getvalue()


def test_decoding_gets_a_bar_and_a_time_left_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = on_terminal(monkeypatch)
    with bar() as on_event:
        on_event(EVENTS[2])
        at = len(screen.getvalue())
        on_event(Decoding(shots=2))
    assert "100%" not in screen.getvalue()[at:] and "0%" in screen.getvalue()[at:]
    with bar() as on_event:
        on_event(EVENTS[2])
        on_event(Decoding(shots=2))
        on_event(Decoded(done=3.0, total=12.0))
    assert "decoding: 25 %" in screen.getvalue() and " 25%" in screen.getvalue()


def test_decoding_in_a_pipe_is_a_line_a_second(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 100.0
    monkeypatch.setattr("pdcd.api.progress.time.monotonic", lambda: now_s)
    with bar() as on_event:
        on_event(Decoding(shots=2))
        for now_s in (100.5, 101.0, 102.0, 105.0):
            on_event(Decoded(done=now_s - 100.0, total=5.0))
    assert capsys.readouterr().err.splitlines() == [
        "decoding",
        "decoding: 10 %, 4 s left",
        "decoding: 40 %, 3 s left",
        "decoding: 100 %",
    ]
