"""Captures of a sweep on several benches at once: in processes of this machine, or on a cluster.

Each worker process keeps a thread of this one waiting. They are started by their own command, not
as copies of the caller: a script needs no main guard, a notebook may start them, and one that dies
takes its own capture with it and no other (decision 0048).
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from typing import Any, Protocol

from pdcd.api.task import Record, Task, failed, taken
from pdcd.child import (
    PICKLES,
    Child,
    LineClosedError,
    module_command,
    single_threaded,
    start,
)
from pdcd.errors import ConfigError, PdcdError
from pdcd.extras import install_hint


class Cluster(Protocol):
    """What is used of a `distributed.Client`."""

    def submit(self, function: Callable[[Task], Record], task: Task, **how: object) -> Any:
        """A future of that function, called with that task."""

    def cancel(self, futures: list[Any]) -> object:
        """Take back what was submitted."""

    def close(self) -> object:
        """Part from the cluster."""


COMMAND = module_command("pdcd.api.worker")
CONNECT_S = 10.0
"""For how long a cluster may not answer."""

Ends = Generator[tuple[int, Record], None, None]
"""Numbers of tasks, and how they ended, as they do."""


def in_processes(tasks: Sequence[Task], workers: int) -> Ends:
    """How the tasks end, as they do, on so many processes of this machine.

    When the iterator is closed early, what still runs is killed; its folders stay `.partial`.
    """
    crew = _Crew()
    pool = ThreadPoolExecutor(workers)
    try:
        futures = {pool.submit(crew.take, task): number for number, task in enumerate(tasks)}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        crew.dismiss()
        pool.shutdown()
        crew.close()


class _Crew:
    """Worker processes, one for each thread that asks."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: queue.SimpleQueue[Child[Any]] = queue.SimpleQueue()
        self._all: list[Child[Any]] = []
        self._dismissed = False

    def take(self, task: Task) -> Record:
        """Have a process take a photo; it is used again unless it died."""
        try:
            worker = self._worker()
        except PdcdError as err:
            return failed(task.request, err)
        try:
            worker.line.send(task)
            answer: Record = worker.line.receive()
        except LineClosedError:
            lost = PdcdError(
                f"its process {worker.how_it_ended()}", hint="killed, or out of memory? see stderr"
            )
            worker.kill()
            return failed(task.request, lost)
        self._idle.put(worker)
        return answer

    def _worker(self) -> Child[Any]:
        with suppress(queue.Empty):
            return self._idle.get_nowait()
        with self._lock:
            if self._dismissed:
                raise PdcdError("the sweep has ended")
            worker = start(
                COMMAND,
                PICKLES,
                what="a process that takes photos",
                environment=single_threaded(),
            )
            self._all.append(worker)
            return worker

    def dismiss(self) -> None:
        """End all of them, whatever they are at; the threads that wait for them then go on."""
        with self._lock:
            self._dismissed = True
            for worker in self._all:
                worker.process.kill()

    def close(self) -> None:
        """Let go of them, once no thread waits any more."""
        for worker in self._all:
            worker.kill()


def on_cluster(tasks: Sequence[Task], cluster: str | Cluster) -> Ends:
    """How the tasks end, as they do, on a Dask cluster.

    cluster : its address, such as "tcp://10.0.0.1:8786", or a client of it. Its workers have pdcd
    installed, and reach the folder of the runs under the same path. Raises ConfigError.
    """
    client = _client(cluster) if isinstance(cluster, str) else cluster
    ends: queue.SimpleQueue[Any] = queue.SimpleQueue()
    futures: dict[Any, int] = {}
    try:
        for number, task in enumerate(tasks):
            # The same request is asked again to see another noise: none is like another.
            future = client.submit(taken, task, pure=False, retries=0)
            futures[future] = number
            future.add_done_callback(ends.put)
        for _ in tasks:
            future = ends.get()
            number, error = futures[future], future.exception()
            lost = PdcdError(f"the cluster lost it: {error}")
            yield number, future.result() if error is None else failed(tasks[number].request, lost)
    finally:
        client.cancel(list(futures))
        if client is not cluster:
            client.close()


def _client(address: str) -> Cluster:
    try:
        import distributed

        found: Any = distributed.Client
        client: Cluster = found(address, set_as_default=False, timeout=CONNECT_S)
        return client
    except ImportError as err:
        raise ConfigError(
            "a sweep on a cluster needs dask.distributed", hint=install_hint("distributed")
        ) from err
    except (OSError, ValueError) as err:
        raise ConfigError(f"no cluster answers at {address}: {err}") from err
