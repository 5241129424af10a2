"""Access to a worker in this process, or in a child of it (`pdcd.capture.worker.spawned`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from pdcd.capture.worker.answers import RigFacts
from pdcd.capture.worker.work import make_memory_error
from pdcd.capture.worker.worker import Worker
from pdcd.watch import Watch

_P = ParamSpec("_P")
_R = TypeVar("_R")


class WorkerProxy(Protocol):
    """Lets a worker do one task at a time."""

    def start(self) -> None:
        """Get ready. Raises PdcdError where that is impossible."""
        ...

    def stop(self) -> None:
        """Stop for good. Idempotent."""
        ...

    def do(
        self,
        watch: Watch,
        task: Callable[Concatenate[Worker, Watch, _P], _R],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _R:
        """Do a task, a method of `Worker`, and return its result.

        `watch` hears of the work in the calling thread, and may raise to end it. Raises what the
        task raises; PlanError or DecodeError when it could not be completed.
        """
        ...


class InProcessWorker:
    """Does the work in this process, at once: without overhead, and without protection."""

    def __init__(self, facts: RigFacts) -> None:
        self._worker = Worker(facts)

    def start(self) -> None:
        """Nothing to do."""

    def stop(self) -> None:
        """Nothing to close."""

    def do(
        self,
        watch: Watch,
        task: Callable[Concatenate[Worker, Watch, _P], _R],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _R:
        """See `WorkerProxy.do`."""
        try:
            return task(self._worker, watch, *args, **kwargs)
        except MemoryError as err:
            raise make_memory_error(task.__name__) from err
