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
"""Longest time between two looks: a cancel takes effect within a second, a call of a device
included."""

_Over = Callable[[], PdcdError]


class _Lock(Protocol):
    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool: ...


class Patience:
    """What every waiting loop of a driver calls in each turn, from `DriverContext.patience`.

    A look gives a sign of life, and raises what ends the wait: `Cancelled` when the job is to end,
    or the error of a deadline that has passed. Deadlines nest, and hold for the thread that set
    them. The same is true of blocks in which a cancel is ignored (`deaf`): in such a block the rig
    closes everything.

    alive : called as the sign of life.
    cancelled : whether the job is to end.
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
        """One turn of a wait. Raises Cancelled, or the error of the outermost deadline that has
        passed."""
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
        """The same, until that time of the rig's clock."""
        begun_ns, step_ns = self._clock.now_ns(), round(LOOK_S * 1e9)
        self.look()
        for at_ns in range(begun_ns + step_ns, t_ns + step_ns, step_ns):
            self._clock.sleep_until_ns(min(at_ns, t_ns))
            self.look()

    def within(self, seconds: float, over: _Over) -> AbstractContextManager[None]:
        """Limit the waits in this block to that many seconds; then raise the error that `over`
        makes."""
        until_ns = self._clock.now_ns() + round(seconds * 1e9)
        return self.until(lambda: self._clock.now_ns() >= until_ns, over)

    @contextmanager
    def until(self, ended: Callable[[], bool], over: _Over) -> Iterator[None]:
        """The same with a condition: the waits end once `ended()` is true; it must stay true."""
        self._thread.ends.append((ended, over))
        try:
            yield
        finally:
            self._thread.ends.pop()

    @contextmanager
    def deaf(self) -> Iterator[None]:
        """Ignore cancels in this block: closing the devices must not be interrupted by the cancel
        that caused it. A driver's own threads do not belong to the job, and work in such a
        block."""
        self._thread.deaf += 1
        try:
            yield
        finally:
            self._thread.deaf -= 1

    def acquire(self, lock: _Lock) -> None:
        """Take a lock that another thread may hold for a long time."""
        while not lock.acquire(timeout=LOOK_S):
            self.look()


class _OfThread(threading.local):
    def __init__(self) -> None:
        self.deaf = 0
        self.ends: list[tuple[Callable[[], bool], _Over]] = []
