"""A process beside this one that closes the shutter when this one cannot, and the talk with it.

What it does then is the business of the driver that has it: `drivers.serial_shutter.guardian` and
`drivers.ptp.guardian`. The talk is words and answers on a line (`pdcd.child`). The kernel closes
this end however this process ends, and that end is the last word.

A guardian is born with every signal blocked: whoever ends or kills a whole service, or the watchdog
that sends SIGABRT to all of it, means the daemon, and then the guardian has its part still to do.
SIGKILL and SIGSTOP cannot be blocked, so an armed guardian is looked after by a thread of this
process, which puts another in the place of one that does not answer. And the other way round: an
armed guardian that hears nothing for `FROZEN_S` takes this process for frozen.
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
"""Between two looks at an armed guardian."""
HEARD_S = 0.3
"""What its answer may take then: one that is dead, stopped or stuck is noticed after `GUARD_LOOK_S`
and this at the latest. One that was only slow is replaced too, which does no harm."""
FROZEN_S = 10.0
"""Of silence, after which an armed guardian does not wait any longer."""
_END_S = 5.0
"""Bound of the end of a guardian that has little left to do."""


def _nothing(why: str) -> None:
    """Nobody to tell."""


class ShutterGuard:
    """One such process, from `start_child`, the first `insist` or the first `arm` on.

    command : what to run; the number of its end of the line is added. It must answer to ``look``.
    inherits : further file descriptors that it gets.
    answer_s : bound of each of its answers, the first with its start.
    unguarded : ends the exposure. Called with the reason, from another thread, when an armed
        guardian is gone and no other can be had; again at the next look where it raises PdcdError.

    Its methods are for one thread at a time; the one that looks after it is the guard's own affair.
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
        """The answer; b"" when there is none, and then that guardian is no more.

        `answer_s` is the bound, None that of the class.
        """
        within_s = self._answer_s if answer_s is None else answer_s
        with self._lock:
            if self._child is None:
                return b""
            try:
                self._child.line.send(word, within_s=within_s)
                return self._child.line.receive(within_s=within_s)
            except (LineClosedError, LineSilentError):
                self._child.kill()  # without its last word
                self._child = None
                return b""

    def insist(self, word: str) -> None:
        """Say it to one that hears, and replaces one that does not. Raises DeviceLost if none does.

        One that does not answer is killed, not asked to end: it would close the shutter first,
        perhaps in a later exposure.
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
        """Insist on a word that arms it, and see until `disarm` that somebody is armed.

        `word()` is asked again for each that replaces another. Raises DeviceLost.
        """
        with self._lock:
            self.insist(word())
            self._stand_down.set()  # whoever looked until now
            self._stand_down = threading.Event()
            self._arm_word = word
            threading.Thread(
                target=_look_after,
                args=(weakref.ref(self), self._stand_down),
                name="pdcd-guard",
                daemon=True,
            ).start()

    def disarm(self) -> bytes:
        """Tell it to stand down; its answer, b"" when there is none."""
        with self._lock:
            self._stand_down.set()
            self._arm_word = None
            return self.ask("disarm")

    def look(self) -> bool:
        """See that the armed guardian answers, replace one that does not; whether one is armed.

        Where none can be had, the exposure is ended, or that is to be tried again.
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
    """Look at a guardian until told not to, or until its guard is forgotten."""
    while not stand_down.wait(GUARD_LOOK_S):
        looked = guard()
        if looked is None or not looked.look():
            return
        del looked
