"""The daemon's end, which waits for no driver.

A driver may block in C, loop, or ignore a cancel. From the signal on::

    at once       every wait of a driver is cancelled; jobs end, devices are released
    ORDERLY_S     what has not ended by then is left: panels and shutter are made safe from
                  another thread, for SAFE_S, and the process ends. Guardians and the presenter
                  see that their lines were closed, and make safe what was not
    KEPT_S        where even that is impossible, because a driver holds the interpreter, another
                  process kills this one (`pdcd.server.keeper`)
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pdcd.child import WORDS, Child, list_end_signals, start_child
from pdcd.errors import PdcdError
from pdcd.server.engine_like import EngineLike
from pdcd.server.worker import ENGINE_THREAD

logger = logging.getLogger(__name__)

ORDERLY_S, SAFE_S, KEPT_S = 6.0, 1.5, 9.0
"""Time in seconds that each way of ending has: since the signal, for making safe, and since the
signal again. All is over within ten seconds."""
_KEEPER = (sys.executable, "-I", "-S", str(Path(__file__).with_name("keeper.py")))
_FAILED = 5
_NOW, _NEVER = b"e", b"n"


class Ending:
    """Makes sure that this process ends in time once it was told to."""

    def __init__(self) -> None:
        self._engine: EngineLike | None = None
        self._told, self._tell = os.pipe()
        self._begun = False
        threading.Thread(target=self._see_to_it, name="pdcd-ending", daemon=True).start()

    def watch(self, engine: EngineLike) -> None:
        """Set the engine that has the devices from now on."""
        self._engine = engine
        if self._begun:
            engine.break_off()

    def begin(self) -> None:
        """Begin to end the daemon. Returns at once; called once, from a signal handler."""
        os.write(self._tell, _NOW)

    def close(self) -> None:
        """Stop watching: the daemon ends by itself."""
        os.write(self._tell, _NEVER)

    def _see_to_it(self) -> None:
        with os.fdopen(self._told, "rb", buffering=0) as told:
            if told.read(1) == _NEVER:
                return
        self._begun = True
        if self._engine is not None:
            self._engine.break_off()
        time.sleep(ORDERLY_S)
        logger.critical("the rig was not let go in %g s, ending without it", ORDERLY_S)
        names = {thread.ident: thread.name for thread in threading.enumerate()}
        for number, frame in sys._current_frames().items():  # noqa: SLF001
            if names.get(number, "").startswith(ENGINE_THREAD):
                code = frame.f_code
                logger.error(
                    "left in %s at %s:%d", code.co_qualname, code.co_filename, frame.f_lineno
                )
        if self._engine is not None and not self._engine.make_safe_beside(SAFE_S):
            logger.critical("panels or shutter are left to the presenter and the guardian")
        os._exit(_FAILED)


@contextmanager
def catch_end(told: Callable[[], object]) -> Iterator[Ending]:
    """Call `told()` in the main thread, from which this is called, when the process is told to end
    (`list_end_signals`), and make sure that it then ends in time, even where its interpreter is
    held."""
    ending, came = Ending(), False

    def handle(_number: int, _frame: object) -> None:
        nonlocal came
        if not came:  # an exception in a handler would end whatever the main thread does
            came = True
            ending.begin()
            told()

    before = {number: signal.signal(number, handle) for number in list_end_signals()}
    keeper = _start_keeper()
    try:
        yield ending
    finally:
        for number, handler in before.items():
            # Handlers no longer work at the end of the interpreter, and no signal should cut that
            # short.
            signal.signal(number, signal.SIG_IGN if came else handler)
        if not came:  # else it watches until this process has ended
            if keeper is not None:
                signal.set_wakeup_fd(-1)
                keeper.hang_up(SAFE_S)
            ending.close()


def _start_keeper() -> Child[bytes] | None:
    """The process that hears of signals from the C library's part of their handlers."""
    command = (*_KEEPER, str(os.getpid()), str(KEPT_S))
    try:
        keeper = start_child(command, WORDS, what="the process that sees to the end", deaf=True)
    except PdcdError as err:
        logger.warning("nobody will end a daemon that is held error=%s", err)
        return None
    os.set_blocking(keeper.line.fileno(), False)
    signal.set_wakeup_fd(keeper.line.fileno(), warn_on_full_buffer=False)
    return keeper
