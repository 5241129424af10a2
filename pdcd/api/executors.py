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
    LineClosedError,
    MessageLine,
    end_with_parent,
    make_child_environment,
    make_module_command,
    start_child,
)
from pdcd.errors import ConfigError, PdcdError
from pdcd.extras import suggest_install

_P = ParamSpec("_P")
_R = TypeVar("_R")

COMMAND = make_module_command("pdcd.api.executors")
_CONNECT_S = 10.0
"""Longest time that a cluster may take to answer."""


class Processes(ThreadPoolExecutor):
    """An executor whose threads each make their calls in a process of their own.

    The processes are started by their own command, not as copies of the caller: a script needs no
    main guard, a notebook may start them, and a process that dies fails only its own call
    (decision 0048). An exception in a call ends its process, so calls should return their errors.
    """

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self._lock = threading.Lock()
        self._here = threading.local()
        self._started: list[Child[Any]] | None = []

    def submit(self, fn: Callable[_P, _R], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_R]:
        """The future of a call; its result raises PdcdError if the process died."""
        return super().submit(self._call, fn, args)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all processes, whatever they are doing."""
        super().shutdown(wait=False, cancel_futures=cancel_futures)
        with self._lock:
            started, self._started = self._started or [], None
        for child in started:
            child.process.kill()  # the thread that waits for it then continues
        super().shutdown()
        for child in started:
            child.kill()

    def _call(self, function: Callable[..., _R], args: tuple[Any, ...]) -> _R:
        child = getattr(self._here, "child", None) or self._start()
        self._here.child = None
        try:
            child.line.send((function, args))
            answer: _R = child.line.receive()
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
            child = start_child(COMMAND, PICKLES, what=what, environment=make_child_environment())
            self._started.append(child)
        return child


def answer_calls(line: MessageLine[Any]) -> None:
    """Make the calls that come over a line, until its other end is gone."""
    try:
        while True:
            function, args = line.receive()
            line.send(function(*args))
    except LineClosedError:
        return


@contextmanager
def connect_cluster(cluster: Any) -> Iterator[Executor]:
    """The executor of a Dask cluster: its address, or a `distributed.Client` of it, which stays
    open. Raises ConfigError."""
    client = _connect(cluster) if isinstance(cluster, str) else cluster
    try:
        # The same request may be repeated for other noise: calls are not pure.
        yield client.get_executor(pure=False, retries=0)
    finally:
        if client is not cluster:
            client.close()


def _connect(address: str) -> Any:
    try:
        import distributed

        found: Any = distributed.Client
        return found(address, set_as_default=False, timeout=_CONNECT_S)
    except ImportError as err:
        raise ConfigError(
            "a sweep on a cluster needs dask.distributed", hint=suggest_install("distributed")
        ) from err
    except (OSError, ValueError) as err:
        raise ConfigError(f"no cluster answers at {address}: {err}") from err


if __name__ == "__main__":
    end_with_parent()
    with MessageLine.at(int(sys.argv[1]), PICKLES) as _ours:
        answer_calls(_ours)
