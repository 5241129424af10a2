"""When the virtual camera makes its files: at once, or in a thread while clients are answered.

A file of the 450D's size takes seconds to make, and minutes on a busy machine, but a client on the
network waits at most 2.5 s for an answer. So a camera in real time makes the file in a thread and
announces it when it is ready, as a real one does. A camera on a virtual clock makes it at once:
nobody waits there, and the outcome must not depend on threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

Develop = Callable[[Callable[[], bytes]], "Future[bytes]"]
"""Takes a function that makes a file; returns the future of that file."""


def develop_at_once(make: Callable[[], bytes]) -> Future[bytes]:
    """Make the file before anything else happens. Raises what `make` raises."""
    made: Future[bytes] = Future()
    made.set_result(make())
    return made


class _LaterFile(Future[bytes]):
    """A file that is made when somebody asks whether it is done and `waits()` is false."""

    def __init__(self, make: Callable[[], bytes], waits: Callable[[], bool]) -> None:
        super().__init__()
        self._make, self._waits = make, waits

    def done(self) -> bool:
        """Whether the file is made; makes it if possible. Raises what making it raises."""
        if not super().done() and not self._waits():
            self.set_result(self._make())
        return super().done()


def develop_after(waits: Callable[[], bool]) -> Develop:
    """Make each file when somebody asks for it and `waits()` is false. What panels show while the
    shutter moves is known only after they have shown it."""
    return lambda make: _LaterFile(make, waits)


@contextmanager
def start_developer() -> Iterator[Develop]:
    """Make files in one thread, in turn; on exit, wait for the file that is being made."""
    pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="virtual-camera-file")
    try:
        yield pool.submit
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
