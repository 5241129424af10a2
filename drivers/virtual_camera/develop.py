"""When the virtual camera makes its files: at once, or in a thread while clients are answered.

A file of the 450D's size takes seconds to make, and minutes on a busy machine, while a client on
the network gives up on an answer after 2.5 s. So a camera in real time makes it meanwhile, and
tells of it when it is there, as a real one does. One that keeps a virtual clock makes it at once:
nobody waits there, and what happens must not depend on threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

Develop = Callable[[Callable[[], bytes]], "Future[bytes]"]
"""Takes what makes a file; returns what holds the file, now or later."""


def develop_at_once(make: Callable[[], bytes]) -> Future[bytes]:
    """Make the file before anything else happens. Raises what `make` raises."""
    made: Future[bytes] = Future()
    made.set_result(make())
    return made


class _LaterFile(Future[bytes]):
    """A file that is made when somebody asks whether it is there, and nothing is waited for."""

    def __init__(self, make: Callable[[], bytes], waits: Callable[[], bool]) -> None:
        super().__init__()
        self._make, self._waits = make, waits

    def done(self) -> bool:
        """Whether it is there. Raises what making it raises."""
        if not super().done() and not self._waits():
            self.set_result(self._make())
        return super().done()


def develop_after(waits: Callable[[], bool]) -> Develop:
    """Make files at once, or while `waits()` as soon as that is over and somebody asks: what panels
    show to a shutter that moves meanwhile is known only when they have shown it."""
    return lambda make: _LaterFile(make, waits)


@contextmanager
def start_developer() -> Iterator[Develop]:
    """Make files in one thread, in turn; the end waits for the one that is being made."""
    pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="virtual-camera-file")
    try:
        yield pool.submit
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
