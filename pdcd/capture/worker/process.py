"""The worker process itself: does one task after the other, reports progress, and answers."""

from __future__ import annotations

import faulthandler
import logging
import time
from typing import Any, NoReturn

# Elsewhere these are loaded only when they are used; here nobody waits for them.
import scipy.fft
import scipy.ndimage
import scipy.sparse
import scipy.special  # noqa: F401

from pdcd.capture.worker.answers import RigFacts
from pdcd.capture.worker.calls import LifeSign, StopCall, TaskCall, TaskFailure, TaskResult
from pdcd.capture.worker.work import SPENT, WORK, make_memory_error
from pdcd.capture.worker.worker import Worker
from pdcd.child import PICKLES, LineClosedError, MessageLine, limit_memory
from pdcd.errors import Cancelled, PdcdError, to_typed_error
from pdcd.watch import Watch

logger = logging.getLogger(__name__)

_LOOK_S = 0.02
"""Least time between two checks whether the work is still wanted."""
_STEP_S = 0.05
"""Least time between two messages about progress."""
_SIGN_S = 0.5
"""Time without any message after which a sign of life is given."""


class TaskLine:
    """This end of the line, which also carries the progress of a task."""

    def __init__(self, line: MessageLine[Any]) -> None:
        self.line = line
        self._looked_s = self._told_s = self._stepped_s = 0.0

    def watch(self) -> Watch:
        """A watch for a task: it informs the other end, and ends the task when told to."""

        def alive() -> None:
            now_s = time.monotonic()
            if now_s - self._looked_s < _LOOK_S:
                return
            self._looked_s = now_s
            if self.line.wait(0.0) and self.line.receive() == StopCall():
                raise Cancelled("the job was cancelled")
            if now_s - self._told_s >= _SIGN_S:
                self._told_s = now_s
                self.line.send(LifeSign())

        def step(done: float, total: float) -> None:
            now_s = time.monotonic()
            # The last step is never left out; sums of many shares come out slightly short.
            if done >= (1.0 - 1e-9) * total or now_s - self._stepped_s >= _STEP_S:
                self._stepped_s = self._told_s = now_s
                self.line.send(LifeSign(done, total, watch.stage))

        watch = Watch(alive, step)
        return watch


def serve_tasks(line: MessageLine[Any]) -> NoReturn:
    """Do tasks until the other end is gone. Raises LineClosedError then."""
    worker, talk = None, TaskLine(line)
    while True:
        message = line.receive()
        if isinstance(message, RigFacts):
            limit_memory(message.config.limits.work_bytes)
            worker = Worker(message)
        elif isinstance(message, TaskCall) and worker is not None:
            line.send(_answer(worker, message, talk.watch()))


def _answer(worker: Worker, call: TaskCall, watch: Watch) -> TaskResult | TaskFailure:
    """Do one task; an error that it raises is the answer."""
    try:
        return TaskResult(WORK[call.name](worker, watch, *call.args, **call.kwargs))
    except LineClosedError:
        raise  # of the line: nobody is left who wants it
    except PdcdError as err:
        failed = TaskFailure(err)
    except MemoryError:
        # The little memory that is left may not be enough for the next task.
        failed = TaskFailure(make_memory_error(call.name), spent=True)
    except Exception as err:
        typed = to_typed_error(err)
        if typed.kind == PdcdError.kind:  # else of the system: it is told, and no fault of ours
            logger.exception("work failed task=%s", call.name)
        failed = TaskFailure(typed)
    worker.forget(watch)
    return failed


def run_worker(fd: int) -> int:
    """Run the process on one end of a line; its exit status."""
    faulthandler.enable()  # a crash in a library leaves a word in the daemon's log
    with MessageLine.at(fd, PICKLES) as line:
        try:
            serve_tasks(line)
        except LineClosedError:
            return 0
        except MemoryError:  # of a message, on its way in or out
            return SPENT
