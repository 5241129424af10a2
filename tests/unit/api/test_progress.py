"""Progress in a notebook: one line that changes, escaped, and is gone in the end."""

from __future__ import annotations

import io
import sys
import types
from typing import Any

import pytest

from pdcd.api.progress import (
    Stages,
    describe_event,
    draw_progress,
    is_notebook,
    read_share_done,
    show_bar,
    show_progress,
)
from pdcd.protocol import events
from pdcd.protocol.events import Attention, Progress


class Handle:
    def __init__(self) -> None:
        self.drawn: list[str] = []

    def update(self, what: object) -> None:
        self.drawn.append(what._repr_html_())  # type: ignore[attr-defined]


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Handle:
    """A cell of a notebook."""
    handle = Handle()

    def display(what: object, *, display_id: bool) -> Handle:
        handle.update(what)
        return handle

    ipython, page = types.ModuleType("IPython"), types.ModuleType("IPython.display")
    vars(ipython).update(get_ipython=lambda: types.SimpleNamespace(kernel=1), display=page)
    vars(page).update(display=display)
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", page)
    return handle


def test_a_line_that_changes_and_is_gone(cell: Handle, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    monkeypatch.setattr("pdcd.api.progress.time.monotonic", lambda: now_s)
    with show_bar() as on_event:
        for now_s in (100.0, 100.1, 100.2, 104.0):  # the second comes too soon
            on_event(Progress(shot="coded", frame=round(now_s * 10) - 1000, frames=160, missed=0))
        now_s = 105.0
        on_event(Attention(text="<b>cover</b> the lens"))
    assert cell.drawn == [
        '<progress max="1"></progress> ',
        '<progress max="1" value="0.000"></progress> coded: 0/160 refreshes',
        '<progress max="1" value="0.013"></progress> coded: 2/160 refreshes, 16 s left',
        '<progress max="1" value="0.250"></progress> coded: 40/160 refreshes, 12 s left',
        '<progress max="1"></progress> &lt;b&gt;cover&lt;/b&gt; the lens',
        "",
    ]


def test_after_an_error_it_stays(cell: Handle) -> None:
    with pytest.raises(ValueError, match="of the job"), show_progress(True) as on_event:
        assert on_event is not None
        on_event(Progress(shot="coded", frame=2, frames=160, missed=0))
        raise ValueError("of the job")
    assert "2/160" in cell.drawn[-1]


def test_who_does_not_want_it_sees_none(cell: Handle, monkeypatch: pytest.MonkeyPatch) -> None:
    with show_progress(False) as on_event:
        assert on_event is None
    with show_progress(print) as on_event:
        assert on_event is print
    assert not cell.drawn and is_notebook()
    monkeypatch.setattr(sys.modules["IPython"], "get_ipython", lambda: None)
    assert not is_notebook()


@pytest.mark.parametrize(
    ("event", "words", "share"),
    [
        (events.Progress(shot="a", frame=3, frames=9, missed=0), "a: 3/9 refreshes", (3, 9)),
        (events.Progress(shot="a", frame=3, frames=9, missed=2), "a: 3/9 refreshes, 2 missed",
         (3, 9)),
        (events.DecodingProgress(done=1.0, total=4.0), "decoding: 25 %", (1.0, 4.0)),
        (events.DecodingProgress(done=0.995, total=1.0), "decoding: 100 %", (0.995, 1.0)),
        (events.PlanningProgress(stage="codes", done=1.0, total=8.0), "planning codes: 12 %",
         (1.0, 8.0)),
        (events.Attention(text="cover\nit"), "cover\\nit", None),
        (events.ShotArmed(shot="a", frames=9), "a: armed", None),
        (events.PartCompleted(part=2, rms_sigma=None, target=0.01),
         "part 2: error unknown, wanted 1 %", None),
        (events.PartCompleted(part=3, rms_sigma=0.01234, target=0.005),
         "part 3: error 1.2 %, wanted 0.5 %", None),
        (events.StepBegun(step="timing", number=1, steps=3), "step 1 of 3: timing", None),
        (events.JobQueued(job="j", ahead=1), "queued", None),
    ],
)  # fmt: skip
def test_events_are_told_in_words(event: Any, words: str, share: Any) -> None:
    assert (describe_event(event), read_share_done(event)) == (words, share)


def test_in_a_pipe_lines_come_at_most_once_a_second_with_the_time_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now_s = 100.0
    monkeypatch.setattr("pdcd.api.progress.time.monotonic", lambda: now_s)
    with show_bar() as on_event:
        on_event(events.ShotArmed(shot="coded", frames=2400))
        for now_s in (100.0, 100.9, 101.0, 101.5, 102.1):
            frame = round((now_s - 100.0) * 1000)
            on_event(Progress(shot="coded", frame=frame, frames=2400, missed=3))
        on_event(events.DecodingStarted(shots=2))
        for now_s in (103.1, 104.1, 105.1):
            on_event(events.DecodingProgress(done=now_s - 102.1, total=10.0))
    assert capsys.readouterr().err.splitlines() == [
        "coded: armed", "coded: 0/2400 refreshes, 3 missed",
        "coded: 1000/2400 refreshes, 3 missed, 1 s left", "coded: 2100/2400 refreshes, 3 missed",
        "decoding", "decoding: 10 %, 9 s left", "decoding: 20 %, 8 s left",
        "decoding: 30 %, 7 s left",
    ]  # fmt: skip


class Terminal(io.StringIO):
    """What a terminal is sent, and how often at once."""

    def __init__(self, *, terminal: bool) -> None:
        super().__init__()
        self.terminal, self.flushed = terminal, 0

    def isatty(self) -> bool:
        return self.terminal

    def flush(self) -> None:
        self.flushed += 1


def test_words_on_a_bar_are_no_markup_and_its_length_may_be_unknown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    screen = Terminal(terminal=True)
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    with show_bar("just begun") as on_event:
        on_event(events.Attention(text="[bold]cover[/bold]"))
        on_event(events.ShotArmed(shot="s", frames=9))
        on_event(events.Progress(shot="s", frame=9, frames=9, missed=0))
    text = screen.getvalue()
    assert "s: 9/9 refreshes" in text and "100%" in text
    screen = Terminal(terminal=True)
    monkeypatch.setattr(sys, "stderr", screen)
    with draw_progress("first") as show:
        show("[bold]cover[/bold]", None, False)
    assert "[bold]cover[/bold]" in screen.getvalue()


def test_the_same_shot_again_is_a_stage_of_its_own() -> None:
    stages = Stages()
    told = [
        events.Progress(shot="a", frame=1, frames=9, missed=0),
        events.Progress(shot="a", frame=2, frames=9, missed=0), events.ShotArmed(shot="a",
        frames=9),
        events.PilotLearning(photos=8), events.DecodingStarted(shots=2),
        events.ShutterOpen(shot="a"),
        events.DecodingProgress(done=1.0, total=2.0), events.Progress(shot="a", frame=1, frames=9,
        missed=0),
    ]  # fmt: skip
    assert [stages.begins(event) for event in told] == [
        True, False, True, True, False, False, False, True,
    ]  # fmt: skip
