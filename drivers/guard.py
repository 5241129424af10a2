"""A process beside this one that closes the shutter when this one cannot, and the line to it.

Each driver says how its guardian closes the shutter: `drivers.serial_shutter.guardian`,
`drivers.ptp.guardian`. The two processes exchange words and answers on a line (`pdcd.child`). The
kernel closes this end however this process ends, and that is the last word.

A guardian starts with every signal blocked: a signal to a whole service, such as the watchdog's
SIGABRT, is meant for the daemon, and then the guardian still has its work to do. SIGKILL and
SIGSTOP cannot be blocked, so a thread of this process watches an armed guardian, and replaces one
that does not answer. In turn, an armed guardian that hears nothing for `FROZEN_S` assumes that this
process is frozen.
"""

from __future__ import annotations

import logging
import threading
import weakref
from collections.abc import Callable, Sequence
from functools import partial

from pdcd.child import WORDS, Child, LineClosedError, LineSilentError, start_child
from pdcd.driver import DeviceLost, PdcdError

logger = logging.getLogger(__name__)

GUARD_LOOK_S = 0.1
"""Time between two checks of an armed guardian."""
HEARD_S = 0.3
"""Longest time for its answer then: a guardian that is dead, stopped or stuck is noticed after
`GUARD_LOOK_S` plus this. One that is only slow is replaced, too, which does no harm."""
FROZEN_S = 10.0
"""Silence after which an armed guardian does not wait any longer."""
_END_S = 5.0
"""Longest time for a guardian with little left to do to end."""


def _nothing(why: str) -> None:
    """Ignore the reason."""


class ShutterGuard:
    """One guardian process, from `start`, the first `insist` or the first `arm` on.

    command : what to run; the number of its end of the line is added. It must answer to ``look``.
    inherits : further file descriptors that it gets.
    answer_s : longest time for each answer; for the first it includes the start.
    unguarded : ends the exposure. Called with the reason, from another thread, when an armed
        guardian is gone and no other can be started; if it raises PdcdError, again at the next
        check.

    Its methods are for one thread at a time, apart from the guard's own watching thread.
    """

    def __init__(
        self,
        command: Sequence[str],
        *inherits: int,
        answer_s: float,
        unguarded: Callable[[str], None] = _nothing,
    ) -> None:
        self._inherits, self._answer_s = inherits, answer_s
        self._command = command
        self._unguarded = unguarded
        self._child: Child[bytes] | None = None
        self._lock = threading.RLock()
        self._arm_word: Callable[[], str] | None = None
        self._stand_down = threading.Event()

    @property
    def pid(self) -> int | None:
        """Process id while it runs."""
        child = self._child
        return None if child is None else child.pid

    def start(self) -> None:
        """Start the process. Raises DeviceLost when that cannot be done."""
        self._child = start_child(
            self._command,
            WORDS,
            what="the process that guards the shutter",
            inherits=self._inherits,
            deaf=True,
            error=partial(DeviceLost, device="shutter"),
        )

    def ask(self, word: str, answer_s: float | None = None) -> bytes:
        """The answer to a word; b"" when there is none, and then that guardian is ended.

        `answer_s` is the longest time for it; None: that of the class.
        """
        within_s = self._answer_s if answer_s is None else answer_s
        with self._lock:
            if self._child is None:
                return b""
            try:
                self._child.line.send(word, within_s=within_s)
                return self._child.line.receive(within_s=within_s)
            except (LineClosedError, LineSilentError):
                self._child.kill()  # before it acts on the end of the line
                self._child = None
                return b""

    def insist(self, word: str) -> None:
        """Send a word, and replace a guardian that does not answer. Raises DeviceLost if none does.

        A guardian that does not answer is killed, not asked to end: it would close the shutter
        first, perhaps during a later exposure.
        """
        with self._lock:
            had_one = self._child is not None
            if self.ask(word):
                return
            if had_one:
                logger.warning("guardian replaced device=shutter")
            self.start()
            if not self.ask(word):
                raise DeviceLost(
                    "the process that guards the shutter does not start",
                    device="shutter",
                    hint="see the log; too many processes?",
                )

    def arm(self, word: Callable[[], str]) -> None:
        """Arm a guardian with a word, and make sure until `disarm` that one is armed.

        `word()` is called again for each replacement. Raises DeviceLost.
        """
        with self._lock:
            self.insist(word())
            self._stand_down.set()  # ends the previous watching thread
            self._stand_down = threading.Event()
            self._arm_word = word
            threading.Thread(
                target=_look_after,
                args=(weakref.ref(self), self._stand_down),
                name="pdcd-guard",
                daemon=True,
            ).start()

    def disarm(self) -> bytes:
        """Disarm it; returns its answer, b"" when there is none."""
        with self._lock:
            self._stand_down.set()
            self._arm_word = None
            return self.ask("disarm")

    def look(self) -> bool:
        """Check that the armed guardian answers, and replace one that does not.

        If none can be started, the exposure is ended. Returns whether to check again: a guardian is
        armed, or ending the exposure has failed.
        """
        with self._lock:
            word, stand_down = self._arm_word, self._stand_down
            if word is None:
                return False
            if self.ask("look", HEARD_S):
                return True
            logger.warning("guardian lost in an exposure device=shutter")
            try:
                self.insist(word())
            except DeviceLost as err:
                self._arm_word, why = None, err.message
            else:
                return True
        logger.critical("no guardian, exposure ended device=shutter error=%s", why)
        try:
            self._unguarded(why)
        except PdcdError as err:
            logger.critical("shutter may be open device=shutter error=%s", err)
            with self._lock:
                if not stand_down.is_set():
                    self._arm_word = word
            return True
        return False

    def stop(self, *, wait: bool = True) -> None:
        """End the process; it closes the shutter first if that is open. Idempotent."""
        with self._lock:
            self._stand_down.set()
            self._arm_word = None
            child, self._child = self._child, None
        if child is None:
            return
        child.hang_up(_END_S if wait else 0.0)
        if wait and child.running:
            child.kill()


def _look_after(guard: weakref.ref[ShutterGuard], stand_down: threading.Event) -> None:
    """Check a guardian until told to stop, or until its guard no longer exists."""
    while not stand_down.wait(GUARD_LOOK_S):
        looked = guard()
        if looked is None or not looked.look():
            return
        del looked
