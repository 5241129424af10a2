"""How a worker is reached: it works in this process, or in a child of it
(`pdcd.capture.worker.spawned`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from pdcd.capture.worker.answers import Facts
from pdcd.capture.worker.work import out_of_memory
from pdcd.capture.worker.worker import Worker
from pdcd.watch import Watch

P = ParamSpec("P")
R = TypeVar("R")


class WorkerProxy(Protocol):
    """Has a worker do one task at a time."""

    def start(self) -> None:
        """Get ready. Raises PdcdError when that cannot be."""
        ...

    def stop(self) -> None:
        """Leave off for good. Idempotent."""
        ...

    def do(
        self,
        watch: Watch,
        task: Callable[Concatenate[Worker, Watch, P], R],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> R:
        """Do a task, a method of `Worker`, and return what it returns.

        `watch` hears of the work in the thread that asks, and may raise to end it. Raises what the
        task raises; PlanError or DecodeError when it could not be brought to an end.
        """
        ...


class InProcessWorker:
    """Does the work in this process, at once: no cost, no shelter."""

    def __init__(self, facts: Facts) -> None:
        self._worker = Worker(facts)

    def start(self) -> None:
        """Nothing is needed."""

    def stop(self) -> None:
        """Nothing is kept open."""

    def do(
        self,
        watch: Watch,
        task: Callable[Concatenate[Worker, Watch, P], R],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> R:
        """See `WorkerProxy.do`."""
        try:
            return task(self._worker, watch, *args, **kwargs)
        except MemoryError as err:
            raise out_of_memory(task.__name__) from err
