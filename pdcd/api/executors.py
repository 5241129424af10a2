"""Executors that take the photos of a sweep: processes of this machine, or a Dask cluster.

`python -m pdcd.api.executors FD` is one of these processes.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, ParamSpec, TypeVar

from pdcd.child import (
    PICKLES,
    Child,
    Line,
    LineClosedError,
    live_for_parent,
    module_command,
    single_threaded,
    start,
)
from pdcd.errors import ConfigError, PdcdError
from pdcd.extras import install_hint

P = ParamSpec("P")
R = TypeVar("R")

COMMAND = module_command("pdcd.api.executors")
CONNECT_S = 10.0
"""For how long a cluster may not answer."""


class Processes(ThreadPoolExecutor):
    """An executor whose threads have their calls made in a process each.

    The processes are started by their own command, not as copies of the caller: a script needs no
    main guard, a notebook may start them, and one that dies fails its own call and no other
    (decision 0048). What a call raises ends its process: it is to return whatever goes wrong.
    """

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self._lock = threading.Lock()
        self._here = threading.local()
        self._started: list[Child[Any]] | None = []

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """The future of a call; it raises PdcdError where the process died."""
        return super().submit(self._call, fn, args)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all processes, whatever they are at."""
        super().shutdown(wait=False, cancel_futures=cancel_futures)
        with self._lock:
            started, self._started = self._started or [], None
        for child in started:
            child.process.kill()  # the thread that waits for it then goes on
        super().shutdown()
        for child in started:
            child.kill()

    def _call(self, function: Callable[..., R], args: tuple[Any, ...]) -> R:
        child = getattr(self._here, "child", None) or self._start()
        self._here.child = None
        try:
            child.line.send((function, args))
            answer: R = child.line.receive()
        except LineClosedError as err:
            lost = f"its process {child.how_it_ended()}"
            child.kill()
            raise PdcdError(lost, hint="killed, or out of memory? see stderr") from err
        self._here.child = child
        return answer

    def _start(self) -> Child[Any]:
        with self._lock:
            if self._started is None:
                raise PdcdError("the sweep has ended")
            what = "a process that takes photos"
            child = start(COMMAND, PICKLES, what=what, environment=single_threaded())
            self._started.append(child)
        return child


def answer_calls(line: Line[Any]) -> None:
    """Make the calls that come over a line, until its other end is gone."""
    try:
        while True:
            function, args = line.receive()
            line.send(function(*args))
    except LineClosedError:
        return


@contextmanager
def cluster_executor(cluster: Any) -> Iterator[Executor]:
    """The executor of a Dask cluster: its address, or a `distributed.Client` of it, which stays
    open. Raises ConfigError."""
    client = _connect(cluster) if isinstance(cluster, str) else cluster
    try:
        # The same request is asked again to see another noise: none is like another.
        yield client.get_executor(pure=False, retries=0)
    finally:
        if client is not cluster:
            client.close()


def _connect(address: str) -> Any:
    try:
        import distributed

        found: Any = distributed.Client
        return found(address, set_as_default=False, timeout=CONNECT_S)
    except ImportError as err:
        raise ConfigError(
            "a sweep on a cluster needs dask.distributed", hint=install_hint("distributed")
        ) from err
    except (OSError, ValueError) as err:
        raise ConfigError(f"no cluster answers at {address}: {err}") from err


if __name__ == "__main__":
    live_for_parent()
    with Line.at(int(sys.argv[1]), PICKLES) as ours:
        answer_calls(ours)
