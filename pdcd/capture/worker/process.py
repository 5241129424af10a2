"""The work process itself: takes one task after the other, tells how far it is, and answers."""

from __future__ import annotations

import faulthandler
import logging
import select
import socket
import time

# Loaded elsewhere only when they are used: here nobody waits for them.
import scipy.fft
import scipy.ndimage
import scipy.sparse
import scipy.special  # noqa: F401

from pdcd.capture.worker.answers import Facts
from pdcd.capture.worker.limits import bound_memory
from pdcd.capture.worker.pipe import PIECE_BYTES, Call, Done, Failed, Inbox, Sign, Stop, packed
from pdcd.capture.worker.work import SPENT, WORK, out_of_memory
from pdcd.capture.worker.worker import Worker
from pdcd.errors import Cancelled, PdcdError
from pdcd.watch import Watch

logger = logging.getLogger(__name__)

LOOK_S = 0.02
"""Least time between two looks whether the work is still wanted."""
STEP_S = 0.05
"""Least time between two messages on how far it is."""
SIGN_S = 0.5
"""Time without any message after which a sign of life is given."""


class Talk:
    """This end of the socket."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._inbox = Inbox()
        self._looked_s = self._told_s = self._stepped_s = 0.0

    def messages(self) -> list[object]:
        """The next messages. Raises EOFError when the other end is gone."""
        while True:
            piece = self._sock.recv(PIECE_BYTES)
            if not piece:
                raise EOFError
            found = list(self._inbox.take(piece))
            if found:
                return found

    def send(self, message: object) -> None:
        """Send a message whole. Raises OSError when the other end is gone."""
        self._sock.sendall(packed(message))

    def watch(self) -> Watch:
        """What hears of a task: it tells the other end, and ends the task when told to."""

        def alive() -> None:
            now_s = time.monotonic()
            if now_s - self._looked_s < LOOK_S:
                return
            self._looked_s = now_s
            if select.select([self._sock], [], [], 0.0)[0] and Stop() in self.messages():
                raise Cancelled("the job was cancelled")
            if now_s - self._told_s >= SIGN_S:
                self._told_s = now_s
                self.send(Sign())

        def step(done: float, total: float) -> None:
            now_s = time.monotonic()
            # The last is never left out; sums of many shares come out a little short.
            if done >= (1.0 - 1e-9) * total or now_s - self._stepped_s >= STEP_S:
                self._stepped_s = self._told_s = now_s
                self.send(Sign(done, total, watch.stage))

        watch = Watch(alive, step)
        return watch


def serve(talk: Talk) -> None:
    """Do what is asked until the other end is gone."""
    worker: Worker | None = None
    while True:
        for message in talk.messages():
            if isinstance(message, Facts):
                bound_memory(message.config.limits.work_bytes)
                worker = Worker(message)
            elif isinstance(message, Call) and worker is not None:
                talk.send(_answer(worker, message, talk.watch()))


def _answer(worker: Worker, call: Call, watch: Watch) -> Done | Failed:
    """Do one task; whatever it raises is the answer."""
    try:
        return Done(WORK[call.name](worker, watch, *call.args, **call.kwargs))
    except (EOFError, BrokenPipeError):
        raise  # of the talk: nobody is left who wants it
    except PdcdError as err:
        failed = Failed(err)
    except MemoryError:
        # What little is left may not do for the next task.
        failed = Failed(out_of_memory(call.name), spent=True)
    except Exception as err:
        logger.exception("work failed task=%s", call.name)
        failed = Failed(PdcdError(f"internal error: {type(err).__name__}: {err}"))
    worker.forget(watch)
    return failed


def main(fd: int) -> int:
    """Run the process on one end of a socket pair; its exit status."""
    faulthandler.enable()  # a crash in a library leaves a word in the daemon's log
    with socket.socket(fileno=fd) as sock:
        try:
            serve(Talk(sock))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return 0
        except MemoryError:  # of a message, on its way in or out
            return SPENT
    return 0
