"""Progress in a notebook: one line of output that changes, and is gone when the job is done."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from pdcd.api.progress import Left, Share, Show
from pdcd.printable import as_html

INTERVAL_S = 0.2
"""Least time between two changes of the line: each is a message to the browser."""


class Markup(str):
    """HTML that a notebook shows as such."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return str(self)


@contextmanager
def line() -> Iterator[Show]:
    """What shows words and the share that is done.

    When the context is left the line is gone; after an error it stays as it was.
    """
    from IPython import display

    # Untyped there; nothing else of it is used.
    handle: Any = display.display(Markup(_drawn("", None)), display_id=True)  # type: ignore[no-untyped-call]
    next_s, left = 0.0, Left()

    def show(words: str, share: Share | None, begins: bool) -> None:
        nonlocal next_s
        ahead = left.words(share, begins)
        if begins or time.monotonic() >= next_s:
            next_s = time.monotonic() + INTERVAL_S
            handle.update(Markup(_drawn(words + ahead, share)))

    yield show
    handle.update(Markup(""))


def _drawn(words: str, share: Share | None) -> str:
    value = f' value="{min(share[0] / share[1], 1.0):.3f}"' if share and share[1] > 0.0 else ""
    return f'<progress max="1"{value}></progress> {as_html(words)}'
