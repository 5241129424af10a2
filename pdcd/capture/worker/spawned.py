"""The daemon's side of the worker: ask it, hear it, and replace it if needed.

The process is started once and kept warm. It may be killed at any time, by anyone: that costs the
job that it worked on, and the next one gets a new process.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from pdcd.capture.worker.answers import RigFacts
from pdcd.capture.worker.calls import (
    WORKER_COMMAND,
    LifeSign,
    StopCall,
    TaskCall,
    TaskFailure,
    TaskResult,
    start_worker,
)
from pdcd.capture.worker.work import FRESH_JOBS, SPENT, WORK, make_memory_error, make_work_error
from pdcd.capture.worker.worker import Worker
from pdcd.child import REAP_S, Child, LineClosedError, LineSilentError
from pdcd.errors import PdcdError
from pdcd.watch import Watch

logger = logging.getLogger(__name__)

STOP_S = 0.1
"""How long a cancelled task may take to end by itself."""

_P = ParamSpec("_P")
_R = TypeVar("_R")


class SpawnedWorker:
    """One worker process at a time; see `pdcd.capture.worker.proxy.WorkerProxy`.

    The kernel ends the process with the thread that started it, so `start` and `do` must be called
    in a thread that lives as long as the process is needed.
    """

    def __init__(
        self,
        facts: RigFacts,
        command: Sequence[str] = WORKER_COMMAND,
        child: Child[Any] | None = None,
    ) -> None:
        """`child` is the first process, where one was started already."""
        self._facts, self._command = facts, command
        self._limits = facts.config.limits
        self._child = child
        self._told = self._busy = False
        self._dying: list[Child[Any]] = []

    @property
    def pid(self) -> int | None:
        """Process number while there is a process."""
        return None if self._child is None else self._child.pid

    def start(self) -> None:
        """Start the process, without waiting until it is warm. Raises PdcdError."""
        self._running()

    def stop(self) -> None:
        """End the process; returns when it is gone. Idempotent."""
        self._kill()
        for child in self._dying:
            child.kill(REAP_S)
        self._dying = []

    def do(
        self,
        watch: Watch,
        task: Callable[Concatenate[Worker, Watch, _P], _R],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _R:
        """Have a task done; `watch` is called at least ten times a second meanwhile.

        Raises what the task raises. A process that died, was silent for `limits.work_silent_s` or
        ran out of memory is replaced, and a PlanError or DecodeError is raised. When `watch`
        raises, the work ends within `STOP_S`, by killing the process if needed.
        """
        name = task.__name__
        if WORK.get(name) is not task:
            raise PdcdError(f"no work is called {name!r}")
        child = self._living(name)
        try:
            answer = self._ask(child, TaskCall(name, tuple(map(_for_child, args)), kwargs), watch)
        except LineClosedError:
            raise self._died(child, name) from None
        except LineSilentError:
            raise self._silent(name) from None
        except BaseException:
            self._interrupt(child)
            raise
        if isinstance(answer, TaskFailure):
            if answer.spent:
                self._replace()
            raise answer.error
        value: _R = answer.value
        return value

    def _ask(self, child: Child[Any], call: TaskCall, watch: Watch) -> TaskResult | TaskFailure:
        """Send a call and wait for the answer, passing progress on to `watch`."""
        silent_s = self._limits.work_silent_s
        self._busy = False
        if not self._told:
            child.line.send(self._facts, within_s=silent_s, alive=watch)
            self._told = True
        child.line.send(call, within_s=silent_s, alive=watch)
        self._busy = True
        while True:
            message = child.line.receive(within_s=silent_s, alive=watch)
            if isinstance(message, TaskResult | TaskFailure):
                return message
            if isinstance(message, LifeSign) and message.total > 0.0:
                watch.stage = message.stage
                watch.step(message.done, message.total)

    def _interrupt(self, child: Child[Any]) -> None:
        """End the current task, which is not wanted any more; as a last resort by a new process."""
        if not self._busy:
            return
        until_s = time.monotonic() + STOP_S

        def in_time() -> None:
            if time.monotonic() >= until_s:
                raise LineSilentError

        with suppress(LineClosedError, LineSilentError):
            child.line.send(StopCall(), alive=in_time)
            while True:
                if isinstance(child.line.receive(alive=in_time), TaskResult | TaskFailure):
                    return  # and it waits for the next task
        self._replace()

    def _living(self, name: str) -> Child[Any]:
        """A process to ask, a new one where there is none. Raises when it died in the middle of a
        job."""
        child = self._child
        if child is not None and not child.running:
            how = child.how_it_ended()
            self._replace()
            if name not in FRESH_JOBS:
                raise make_work_error(name, how, "see the daemon's log")
            logger.warning("worker replaced reason=%r", how)
        return self._running()

    def _running(self) -> Child[Any]:
        if self._child is None:
            self._child, self._told = start_worker(self._command), False
        return self._child

    def _replace(self) -> None:
        """Kill the process if it lives, and start the next one, which warms up meanwhile."""
        self._kill()
        try:
            self.start()
        except PdcdError as err:  # the next task tries again
            logger.error("worker not started error=%s", err)

    def _kill(self) -> None:
        child, self._child = self._child, None
        self._dying = [dying for dying in self._dying if dying.running]
        if child is not None:
            # A large one takes the kernel a while; nobody needs to wait for that.
            child.kill(reap_s=0.0)
            self._dying.append(child)

    def _silent(self, name: str) -> PdcdError:
        self._replace()
        return make_work_error(
            name,
            f"gave no sign of life for {self._limits.work_silent_s:g} s and was killed",
            "see the daemon's log, or raise limits.work_silent_s",
        )

    def _died(self, child: Child[Any], name: str) -> PdcdError:
        how = child.how_it_ended()
        spent = child.process.returncode == SPENT
        self._replace()
        return (
            make_memory_error(name) if spent else make_work_error(name, how, "see the daemon's log")
        )


def _for_child(argument: Any) -> Any:
    """An argument that the child can use: a path through a descriptor of this process is written
    with the process number, because the child has descriptors of its own."""
    own = Path("/proc/self/fd")
    if isinstance(argument, Path) and argument.is_relative_to(own):
        return Path(f"/proc/{os.getpid()}/fd") / argument.relative_to(own)
    return argument
