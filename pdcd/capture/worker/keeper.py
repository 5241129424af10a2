"""The daemon's side of the work process: start it, ask it, hear it, and kill it if need be.

The process is started once and kept warm. It may be killed at any time, by whomever: that costs the
job that it worked on, and the next one gets a new process.
"""

from __future__ import annotations

import logging
import os
import select
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from pdcd.capture.worker.answers import Facts
from pdcd.capture.worker.birth import COMMAND, Newborn, born
from pdcd.capture.worker.pipe import PIECE_BYTES, Call, Done, Failed, Inbox, Sign, Stop, packed
from pdcd.capture.worker.work import FIRST, SPENT, WORK, broken, out_of_memory
from pdcd.capture.worker.worker import Worker
from pdcd.errors import PdcdError
from pdcd.watch import Watch

logger = logging.getLogger(__name__)

LOOK_S = 0.05
"""Time between two signs of life of the thread that waits."""
STOP_S = 0.1
"""How long a cancelled task may take to end by itself."""
DEATH_S = 5.0
"""How long the kernel may take to bury a killed process."""

P = ParamSpec("P")
R = TypeVar("R")


class Child:
    """One work process at a time; see `pdcd.capture.worker.proxy.WorkerProxy`.

    The kernel ends the process with the thread that started it, so `start` and `do` belong to a
    thread that lives as long as it is wanted.
    """

    def __init__(
        self, facts: Facts, command: Sequence[str] = COMMAND, newborn: Newborn | None = None
    ) -> None:
        """`newborn` is the first process, where one was started already."""
        self._facts, self._command = facts, command
        self._limits = facts.config.limits
        self._process: subprocess.Popen[bytes] | None = None
        self._talk: socket.socket | None = None
        self._inbox = Inbox()
        self._told = self._busy = False
        self._heard_s = 0.0
        self._dying: list[subprocess.Popen[bytes]] = []
        if newborn is not None:
            self._take(newborn)

    @property
    def pid(self) -> int | None:
        """Process number while there is a process."""
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        """Start the process, without waiting until it is warm. Raises PdcdError."""
        self._reap()
        if self._process is not None:
            return
        self._take(born(self._command))

    def stop(self) -> None:
        """End the process; returns when it is gone. Idempotent."""
        self._kill()
        for process in self._dying:
            with suppress(subprocess.TimeoutExpired):
                process.wait(DEATH_S)
        self._reap()

    def do(
        self,
        watch: Watch,
        task: Callable[Concatenate[Worker, Watch, P], R],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> R:
        """Have a task done; `watch` gives a sign of life at least ten times a second meanwhile.

        Raises what the task raises. A process that died, hung for `limits.work_silent_s` or ran out
        of memory is replaced, and is a PlanError or DecodeError. When `watch` raises, the work ends
        within `STOP_S`, by killing the process if need be.
        """
        name = task.__name__
        if WORK.get(name) is not task:
            raise PdcdError(f"no work is called {name!r}")
        self._see_that_it_lives(name)
        call = Call(name, tuple(map(_for_child, args)), kwargs)
        said = packed(call) if self._told else packed(self._facts) + packed(call)
        self._heard_s = time.monotonic()
        try:
            self._send(name, said, watch)
        except BaseException:
            self._replace()  # it may have half a message
            raise
        self._told = self._busy = True
        try:
            answer = self._answer(name, watch)
        except BaseException:
            if self._busy:
                self._interrupt()
            raise
        self._busy = False
        if isinstance(answer, Failed):
            if answer.spent:
                self._replace()
            raise answer.error
        value: R = answer.value
        return value

    def _take(self, newborn: Newborn) -> None:
        self._process, self._talk = newborn.process, newborn.talk
        self._inbox, self._told = Inbox(), False

    def _see_that_it_lives(self, name: str) -> None:
        """A process to ask, a new one where there is none. Raises when it died amid a job."""
        if self._process is not None and self._process.poll() is not None:
            how = self._how_it_ended()
            self._replace()
            if name not in FIRST:
                raise broken(name, how, "see the daemon's log")
            logger.warning("work process replaced reason=%r", how)
        self.start()

    def _send(self, name: str, said: bytes, watch: Watch) -> None:
        """Send all of it. Raises PlanError or DecodeError."""
        rest = memoryview(said)
        while rest:
            watch()
            if self._ready(select.POLLOUT):
                try:
                    rest = rest[self._socket.send(rest[:PIECE_BYTES]) :]
                except BlockingIOError:
                    continue
                except OSError:
                    raise self._died(name) from None
            self._see_that_it_is_not_stuck(name)

    def _answer(self, name: str, watch: Watch) -> Done | Failed:
        """Wait for the answer, telling `watch` what is told meanwhile."""
        while True:
            watch()
            if not self._ready(select.POLLIN):
                self._see_that_it_is_not_stuck(name)
                continue
            try:
                piece = self._socket.recv(PIECE_BYTES)
            except OSError:
                piece = b""
            if not piece:
                raise self._died(name)
            self._heard_s = time.monotonic()
            for message in self._inbox.take(piece):
                if isinstance(message, Done | Failed):
                    return message
                if isinstance(message, Sign) and message.total > 0.0:
                    watch.stage = message.stage
                    watch.step(message.done, message.total)

    def _interrupt(self) -> None:
        """Have the task ended that is not wanted any more; in the end by a new process."""
        until_s = time.monotonic() + STOP_S
        try:
            if self._talk is not None:
                self._talk.send(packed(Stop()))
            while self._talk is not None and time.monotonic() < until_s:
                if self._ready(select.POLLIN):
                    piece = self._talk.recv(PIECE_BYTES)
                    if not piece:
                        break
                    if any(isinstance(m, Done | Failed) for m in self._inbox.take(piece)):
                        self._busy = False
                        return  # and it waits for the next task
        except OSError as err:
            logger.warning("work process lost error=%s", err)
        self._replace()

    def _replace(self) -> None:
        """Kill the process if it lives, and start the next one, which gets warm meanwhile."""
        self._kill()
        try:
            self.start()
        except PdcdError as err:  # the next task tries again
            logger.error("work process not started error=%s", err)

    def _kill(self) -> None:
        self._busy = False
        process, self._process = self._process, None
        if self._talk is not None:
            self._talk.close()
            self._talk = None
        if process is not None:
            process.kill()
            # A large one takes the kernel a while; nobody needs to wait for that.
            self._dying.append(process)

    def _reap(self) -> None:
        self._dying = [process for process in self._dying if process.poll() is None]

    def _see_that_it_is_not_stuck(self, name: str) -> None:
        silent_s = self._limits.work_silent_s
        if time.monotonic() - self._heard_s > silent_s:
            self._replace()
            raise broken(
                name,
                f"gave no sign of life for {silent_s:g} s and was killed",
                "see the daemon's log, or raise limits.work_silent_s",
            )

    def _died(self, name: str) -> PdcdError:
        how = self._how_it_ended()
        spent = self._process is not None and self._process.returncode == SPENT
        self._replace()
        return out_of_memory(name) if spent else broken(name, how, "see the daemon's log")

    def _how_it_ended(self) -> str:
        """In words that follow on "the process"."""
        status: int | None = None
        if self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                status = self._process.wait(STOP_S)
        if status is None:
            return "closed its end"
        if status >= 0:
            return f"ended with status {status}"
        with suppress(ValueError):
            return f"was ended by signal {-status} ({signal.Signals(-status).name})"
        return f"was ended by signal {-status}"

    def _ready(self, event: int) -> bool:
        """Whether the socket can be read or written, after a wait of `LOOK_S` at most."""
        poller = select.poll()
        poller.register(self._socket, event)
        return bool(poller.poll(LOOK_S * 1000))

    @property
    def _socket(self) -> socket.socket:
        if self._talk is None:
            raise PdcdError("the process that plans and decodes was not started")
        return self._talk


def _for_child(argument: Any) -> Any:
    """An argument as the child can use it: a path by one of this process' descriptors is told as
    that, since the child has descriptors of its own."""
    own = Path("/proc/self/fd")
    if isinstance(argument, Path) and argument.is_relative_to(own):
        return Path(f"/proc/{os.getpid()}/fd") / argument.relative_to(own)
    return argument
