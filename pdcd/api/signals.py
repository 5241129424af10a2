"""Interrupts while a job runs: they first end it in good order, and are delivered afterwards."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from pdcd.child import list_end_signals

_Handler = Callable[[int, FrameType | None], object]


@contextmanager
def send_signals_to(handler: _Handler) -> Iterator[None]:
    """Send SIGINT, SIGTERM and SIGHUP to `handler` inside the block. For the main thread only."""
    numbers = list_end_signals()
    before = [signal.signal(number, handler) for number in numbers]
    try:
        yield
    finally:
        for number, handled in zip(numbers, before, strict=True):
            signal.signal(number, handled)


@contextmanager
def hold_signals(*, raises: bool = False, delivers: bool = True) -> Iterator[Callable[[], bool]]:
    """Hold SIGINT, SIGTERM and SIGHUP back until the context is left, and deliver them then.

    Yields a function that says whether one came. With `raises`, a signal also raises
    KeyboardInterrupt inside; a second one always does. Without `delivers`, none is delivered, as
    the job's end says enough. In a thread that cannot handle signals nothing is held back.
    """
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)
        if raises or len(came) > 1:  # the second time, the user does not want to wait
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    with send_signals_to(note):
        yield lambda: bool(came)
    if came and delivers:
        signal.raise_signal(came[0])
