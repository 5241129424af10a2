"""Connects drivers that wait with the job that they wait for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Pulse:
    """Passes the drivers' signs of life on to whoever runs the job, and its cancel to them."""

    def __init__(self, broken_off: Callable[[], bool]) -> None:
        self.heard_by: Callable[[], object] | None = None
        self._broken_off = broken_off

    def __call__(self) -> None:
        """One sign of life, from the thread that runs the job."""
        if self.heard_by is not None:
            self.heard_by()

    @contextmanager
    def of_job(self, cancelled: Callable[[], bool]) -> Iterator[None]:
        """Pass signs of life to a job, and its cancel to the drivers."""
        self.heard_by = cancelled
        try:
            yield
        finally:
            self.heard_by = None

    def cancelled(self) -> bool:
        """Whether drivers are to stop waiting."""
        return self._broken_off() or (self.heard_by is not None and bool(self.heard_by()))
