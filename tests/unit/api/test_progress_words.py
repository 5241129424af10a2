"""Progress in words and shares, on a bar, in lines and in a notebook, at the edges of each."""

from __future__ import annotations

import io
import sys
import types
from typing import Any

import pytest

from pdcd.api import progress as module
from pdcd.api.progress import (
    Stages,
    describe_event,
    draw_progress,
    read_share_done,
    show_bar,
    show_progress,
)
from pdcd.protocol import events


class Terminal(io.StringIO):
    """What a terminal is sent, and how often at once."""

    def __init__(self, *, terminal: bool) -> None:
        super().__init__()
        self.terminal, self.flushed = terminal, 0

    def isatty(self) -> bool:
        return self.terminal

    def flush(self) -> None:
        self.flushed += 1


@pytest.mark.parametrize(
    ("event", "words"),
    [
        (events.PartCompleted(part=2, rms_sigma=None, target=0.01),
         "part 2: error unknown, wanted 1 %"),
        (events.PartCompleted(part=3, rms_sigma=0.01234, target=0.005),
         "part 3: error 1.2 %, wanted 0.5 %"),
        (events.StepBegun(step="timing", number=1, steps=3), "step 1 of 3: timing"),
        (events.StepEnded(step="timing", verdict="good", photos=0, seconds=0.0, figures=(),
                          advice=()), "timing: good"),
        (events.ShutterOpen(shot="s"), "s: shutter open"),
        (events.JobQueued(job="j", ahead=1), "queued"),
        (events.DecodingProgress(done=0.995, total=1.0), "decoding: 100 %"),
    ],
)  # fmt: skip
def test_events_without_a_share_are_told_in_words(event: events.Event, words: str) -> None:
    assert describe_event(event) == words
    assert (read_share_done(event) is None) == (not isinstance(event, events.DecodingProgress))


def test_what_is_told_is_one_line_and_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal(terminal=False)
    monkeypatch.setattr(sys, "stderr", screen)
    module.tell_user("a\nb")
    assert screen.getvalue() == "a\\nb\n" and screen.flushed == 1


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


def test_in_a_pipe_the_first_words_are_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal(terminal=False)
    monkeypatch.setattr(sys, "stderr", screen)
    with show_bar("waiting"):
        pass
    with show_progress(True) as on_event:
        assert on_event is not None
        on_event(events.ShotArmed(shot="s", frames=9))
    assert screen.getvalue() == "s: armed\n"


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


def test_a_line_of_a_notebook_is_full_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []

    class Handle:
        def update(self, what: Any) -> None:
            told.append(what._repr_html_())

    def display(what: Any, *, display_id: bool) -> Handle:
        told.append(f"{display_id} {what._repr_html_()}")
        return Handle()

    ipython, page = types.ModuleType("IPython"), types.ModuleType("IPython.display")
    vars(ipython).update(display=page)
    vars(page).update(display=display)
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", page)
    with module.show_notebook_line() as show:
        for share in ((3.0, 2.0), (1.0, 2.0), (1.0, 0.0), (1.0, 0.5), None):
            show("w", share, True)
    empty = '<progress max="1"></progress>'
    full = '<progress max="1" value="1.000"></progress>'
    assert told == [
        f"True {empty} ", f"{full} w", '<progress max="1" value="0.500"></progress> w',
        f"{empty} w", f"{full} w", f"{empty} w", "",
    ]  # fmt: skip
