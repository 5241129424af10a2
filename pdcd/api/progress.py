"""Progress of a capture: shown to whoever watches, in a notebook or on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pdcd.runs.events import Event

OnEvent = Callable[[Event], None]
Shown = bool | OnEvent
"""Whether to show progress, or what takes each event instead."""


@contextmanager
def shown(progress: Shown) -> Iterator[OnEvent | None]:
    """What takes the events of one job, None where nobody wants them."""
    yield progress if callable(progress) else None
