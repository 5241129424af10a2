"""How long a driver waits: one deadline and one cancel for every loop that waits for a device."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Protocol

from pdcd.errors import Cancelled, PdcdError

if TYPE_CHECKING:
    from pdcd.bench.devices import Clock

LOOK_S = 0.2
"""Longest time between two looks: a cancel is heard within a second, a device's call included."""

_Over = Callable[[], PdcdError]


class _Lock(Protocol):
    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool: ...


class Patience:
    """What every loop of a driver asks in each turn, from `DriverContext.patience`.

    A look gives a sign of life, and raises what ends the wait: `Cancelled` when the job is to end,
    or the error of a deadline that is over. Deadlines nest, and are those of the thread that set
    them; so is deafness, in which a cancel is not heard: the rig closes everything in it.

    alive : takes a sign of life. cancelled : whether the job is to end.
    """

    def __init__(
        self,
        clock: Clock,
        alive: Callable[[], object] = lambda: None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> None:
        self._clock, self._alive, self._cancelled = clock, alive, cancelled
        self._thread = _OfThread()

    def look(self) -> None:
        """One turn of a wait. Raises Cancelled, or the error of the outermost deadline over."""
        self._alive()
        if not self._thread.deaf and self._cancelled():
            raise Cancelled("cancelled while a device was waited for")
        for ended, over in self._thread.ends:
            if ended():
                raise over()

    def sleep(self, seconds: float) -> None:
        """Wait on the rig's clock, looking often enough."""
        self.sleep_until_ns(self._clock.now_ns() + round(seconds * 1e9))

    def sleep_until_ns(self, t_ns: int) -> None:
        """The same, until that time of it."""
        begun_ns, step_ns = self._clock.now_ns(), round(LOOK_S * 1e9)
        self.look()
        for at_ns in range(begun_ns + step_ns, t_ns + step_ns, step_ns):
            self._clock.sleep_until_ns(min(at_ns, t_ns))
            self.look()

    def within(self, seconds: float, over: _Over) -> AbstractContextManager[None]:
        """See that what waits in this block ends in so many seconds, by the error that `over`
        makes."""
        until_ns = self._clock.now_ns() + round(seconds * 1e9)
        return self.until(lambda: self._clock.now_ns() >= until_ns, over)

    @contextmanager
    def until(self, ended: Callable[[], bool], over: _Over) -> Iterator[None]:
        """The same, as soon as `ended()`, which is to stay true."""
        self._thread.ends.append((ended, over))
        try:
            yield
        finally:
            self._thread.ends.pop()

    @contextmanager
    def deaf(self) -> Iterator[None]:
        """Hear no cancel in this block: what closes must not be broken off by what it is for.
        Threads of a driver's own are not the job's, and work in it."""
        self._thread.deaf += 1
        try:
            yield
        finally:
            self._thread.deaf -= 1

    def acquire(self, lock: _Lock) -> None:
        """Take a lock that another thread may hold for long."""
        while not lock.acquire(timeout=LOOK_S):
            self.look()


class _OfThread(threading.local):
    def __init__(self) -> None:
        self.deaf = 0
        self.ends: list[tuple[Callable[[], bool], _Over]] = []
