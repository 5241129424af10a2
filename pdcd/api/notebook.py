"""Progress in a notebook: one line of output that changes, and is gone when the job is done."""

from __future__ import annotations

import html
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from pdcd.api.progress import OnEvent, share_of, words_of
from pdcd.runs.events import Event

INTERVAL_S = 0.2
"""Least time between two changes of the line: each is a message to the browser."""


class Markup(str):
    """HTML that a notebook shows as such."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return str(self)


def here() -> bool:
    """Whether this is a cell of a notebook, which shows HTML; a terminal with IPython is none."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return hasattr(shell, "kernel")


@contextmanager
def line() -> Iterator[Callable[[str, float | None], None]]:
    """What shows words and the share that is done, None where that is not known.

    When the context is left the line is gone; after an error it stays as it was.
    """
    from IPython import display

    # What is untyped there: nothing else of it is used.
    handle: Any = display.display(Markup(_drawn("", None)), display_id=True)  # type: ignore[no-untyped-call]
    next_s = 0.0

    def show(words: str, share: float | None) -> None:
        nonlocal next_s
        if time.monotonic() >= next_s:
            next_s = time.monotonic() + INTERVAL_S
            handle.update(Markup(_drawn(words, share)))

    yield show
    handle.update(Markup(""))


@contextmanager
def progress() -> Iterator[OnEvent]:
    """What takes the events of one job and shows them as a line."""
    with line() as show:

        def on_event(event: Event) -> None:
            found = share_of(event)
            show(words_of(event), None if found is None else found[0] / found[1])

        yield on_event


def _drawn(words: str, share: float | None) -> str:
    value = "" if share is None else f' value="{min(max(share, 0.0), 1.0):.3f}"'
    return f'<progress max="1"{value}></progress> {html.escape(words)}'
