"""Progress of a job, shown to the user: a bar in a notebook or on a terminal, else lines."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from pdcd.printable import to_html, to_one_line, write_stderr
from pdcd.protocol.events import (
    Attention,
    DecodingProgress,
    DecodingStarted,
    Event,
    PartCompleted,
    PilotLearning,
    PlanningProgress,
    Progress,
    ShotArmed,
    StepBegun,
    StepEnded,
    pick_event_fields,
)
from pdcd.watch import Watch

EventListener = Callable[[Event], None]
"""Takes one event, a struct of `pdcd.protocol.events`; `type` names its kind."""

ProgressChoice = bool | EventListener
"""Whether to show progress, or a function that takes each event instead."""

_Share = tuple[float, float]
"""Work done, and work in all."""
_Show = Callable[[str, _Share | None, bool], None]
"""Shows words and the share that is done, if known; the last argument says that a stage begins."""

_NOTEBOOK_INTERVAL_S = 0.2
"""Least time between two changes of the line: each is a message to the browser."""
_LINE_INTERVAL_S = 1.0
"""Least time between two progress lines where no bar can be drawn."""


@contextmanager
def show_progress(progress: ProgressChoice) -> Iterator[EventListener | None]:
    """Yield the function that takes the events of one job; None where they are not wanted."""
    if callable(progress) or not progress:
        yield progress or None
        return
    with show_bar() as on_event:
        yield on_event


def tell_user(text: str) -> None:
    """Print one line for the user on stderr; never part of the result. Escaped as by `say`."""
    write_stderr(to_one_line(text) + "\n")


@contextmanager
def show_bar(first: str = "waiting") -> Iterator[EventListener]:
    """Yield a function that shows the events of one job; `first` is shown before the first one."""
    stages = Stages()
    with draw_progress(first) as show:
        yield lambda event: show(
            describe_event(event), read_share_done(event), stages.begins(event)
        )


def watch_decoding(on_event: EventListener | None) -> Watch:
    """A watch of one decoding, whose progress goes to `on_event`."""
    if on_event is None:
        return Watch()
    return Watch(step=lambda done, total: on_event(DecodingProgress(done=done, total=total)))


@contextmanager
def draw_progress(first: str) -> Iterator[_Show]:
    """Yield a function that shows words and a share: a line in a notebook, a bar on a terminal,
    else lines on stderr, at most one a second."""
    if is_notebook():
        with show_notebook_line() as show:
            yield show
        return
    if not sys.stderr.isatty():
        yield _Paced(lambda words, share: tell_user(words), _LINE_INTERVAL_S).show
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=Console(stderr=True)) as bars:
        task = bars.add_task(first, total=None)

        def on_bar(words: str, share: _Share | None, begins: bool) -> None:
            done, total = share or (None, None)
            if begins:  # so that the time left is for this stage
                bars.reset(task, total=total or 1.0, description=words)
            bars.update(task, description=words, completed=done, total=total)

        yield on_bar


def is_notebook() -> bool:
    """Whether this runs in a notebook, which shows HTML; IPython in a terminal does not count."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")


class _Markup(str):
    """HTML that a notebook shows as such."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return str(self)


@contextmanager
def show_notebook_line() -> Iterator[_Show]:
    """Yield a function that shows words and the share that is done, in one line.

    The line disappears when the context is left; after an error it stays as it was.
    """
    from IPython import display

    # Untyped there; nothing else of it is used.
    handle: Any = display.display(_Markup(_line_html("", None)), display_id=True)  # type: ignore[no-untyped-call]
    yield _Paced(
        lambda words, share: handle.update(_Markup(_line_html(words, share))), _NOTEBOOK_INTERVAL_S
    ).show
    handle.update(_Markup(""))


def _line_html(words: str, share: _Share | None) -> str:
    value = f' value="{min(share[0] / share[1], 1.0):.3f}"' if share and share[1] > 0.0 else ""
    return f'<progress max="1"{value}></progress> {to_html(words)}'


class _Paced:
    """Writes words with the time that is left of a stage, estimated from its share done so far. A
    share is written at most once every `interval_s` seconds."""

    def __init__(self, write: Callable[[str, _Share | None], object], interval_s: float) -> None:
        self._write, self._interval_s = write, interval_s
        self._begun_s = self._next_s = 0.0

    def show(self, words: str, share: _Share | None, begins: bool) -> None:
        """Write it, unless the previous share was written just now."""
        now_s = time.monotonic()
        if begins:
            self._begun_s = now_s
        if share is not None and not begins and now_s < self._next_s:
            return
        done, total = share or (0.0, 0.0)
        left_s = (now_s - self._begun_s) * (total - done) / done if done else 0.0
        if share is not None:
            self._next_s = now_s + self._interval_s
        self._write(words + f", {left_s:.0f} s left" * (left_s >= 1.0), share)


class Stages:
    """The stages that have progress of their own: the plan, each exposure, making pictures."""

    def __init__(self) -> None:
        self._stage: str | None = None

    def begins(self, event: Event) -> bool:
        """Whether the event is the first of a stage."""
        if isinstance(event, (ShotArmed, Progress)):
            stage = f"shot {event.shot}"
        elif isinstance(event, PlanningProgress):
            stage = "planning"
        elif isinstance(event, (PilotLearning, DecodingStarted, DecodingProgress)):
            stage = "decoding"
        else:
            return False
        new = stage != self._stage or isinstance(event, ShotArmed)
        self._stage = stage
        return new


def read_share_done(event: Event) -> _Share | None:
    """Work done, and work in all; None where the event does not say."""
    if isinstance(event, Progress):
        return event.frame, event.frames
    return (
        (event.done, event.total)
        if isinstance(event, (DecodingProgress, PlanningProgress))
        else None
    )


def describe_event(event: Event) -> str:
    """Where the job stands, in words: the shot, if the event names one, and step or refreshes."""
    return to_one_line(_plain_words(event))


def _plain_words(event: Event) -> str:
    step = event.type.replace("_", " ")
    if isinstance(event, DecodingProgress):
        return f"decoding: {100.0 * event.done / event.total:.0f} %"
    if isinstance(event, PlanningProgress):
        return f"planning {event.stage}: {100.0 * event.done / event.total:.0f} %"
    if isinstance(event, PartCompleted):
        error = "unknown" if event.rms_sigma is None else f"{100.0 * event.rms_sigma:.2g} %"
        return f"part {event.part}: error {error}, wanted {100.0 * event.target:g} %"
    if isinstance(event, StepBegun):
        note = f"{event.note}; " if event.note else ""
        return f"{note}step {event.number} of {event.steps}: {event.step}"
    if isinstance(event, StepEnded):
        return f"{event.step}: {event.verdict}"
    if isinstance(event, Attention):
        return event.text
    if isinstance(event, Progress):
        step = f"{event.frame}/{event.frames} refreshes"
        if event.missed:
            step += f", {event.missed} missed"
    shot = pick_event_fields(event).get("shot")
    return f"{shot}: {step}" if shot else step
