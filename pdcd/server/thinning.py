"""Events of a job on their way from the engine's thread to the loop: progress is thinned."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable

from pdcd.protocol.events import THINNED, Event

PROGRESS_INTERVAL_NS = 100_000_000
"""Least time between two thinned events of a job: at most ten a second."""


class Coalescer:
    """Thins events to one per `interval_ns`; of those held back, the newest is kept.

    The thread that captures offers them. Where nothing follows a held event, a timer of the event
    loop sends it: `wants_timer` asks for the timer, which calls `due`, and starts again while
    `timed`.
    """

    def __init__(self, interval_ns: int = PROGRESS_INTERVAL_NS) -> None:
        self._interval_ns = interval_ns
        self._last_ns: int | None = None
        self._held: tuple[int, Event] | None = None
        self.timed = False
        self._lock = threading.Lock()

    def offer(self, now_ns: int, event: Event) -> Event | None:
        """The event if it may go out now; else it is held and None is returned."""
        with self._lock:
            if self._early(now_ns):
                self._held = (now_ns, event)
                return None
            self._last_ns = now_ns
            self._held = None
            return event

    def wants_timer(self) -> bool:
        """Whether something is held and no timer runs; the caller then starts one."""
        with self._lock:
            wanted = self._held is not None and not self.timed
            self.timed = self.timed or wanted
            return wanted

    def due(self, now_ns: int) -> tuple[int, Event] | None:
        """Time and event of what is held, if it may go out by now."""
        with self._lock:
            if self._held is not None and self._early(now_ns):
                return None
            self.timed = False
            held, self._held = self._held, None
            if held is not None:
                self._last_ns = now_ns
            return held

    def flush(self) -> tuple[int, Event] | None:
        """Time and event of what is held, to go out before any other event; None if nothing."""
        with self._lock:
            held, self._held = self._held, None
            return held

    def _early(self, now_ns: int) -> bool:
        return self._last_ns is not None and now_ns - self._last_ns < self._interval_ns


class EventsToLoop:
    """Events of one job on their way from the engine's thread to the loop, progress thinned.

    tell : takes the time in ns and the event, in the loop.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, tell: Callable[[int, Event], object]
    ) -> None:
        self._loop, self._tell = loop, tell
        self._thinned = Coalescer()
        self._late_s = PROGRESS_INTERVAL_NS * 1e-9

    def emit(self, event: Event) -> None:
        """In the engine's thread: send it on, or hold it back for a while."""
        now_ns = time.monotonic_ns()
        if not isinstance(event, THINNED):
            self.flush()
            self._send(now_ns, event)
        elif self._thinned.offer(now_ns, event) is not None:
            self._send(now_ns, event)
        elif self._thinned.wants_timer():
            self._loop.call_soon_threadsafe(self._loop.call_later, self._late_s, self._tell_late)

    def flush(self) -> None:
        """In the engine's thread: send what was held back."""
        held = self._thinned.flush()
        if held is not None:
            self._send(*held)

    def _send(self, t_ns: int, event: Event) -> None:
        self._loop.call_soon_threadsafe(self._tell, t_ns, event)

    def _tell_late(self) -> None:
        """In the loop: nothing followed the held event, because the rig waits, or hangs."""
        held = self._thinned.due(time.monotonic_ns())
        if held is not None:
            self._tell(*held)
        elif self._thinned.timed:
            self._loop.call_later(self._late_s, self._tell_late)
