"""What releases the shutter line when the driver cannot.

A port of this machine gets a `Guardian`: a process that outlives the daemon and shares no lock with
it. A port without a file descriptor (rfc2217 and the like) cannot be handed to another process and
gets an `Alarm`: a thread, which helps when the daemon is stuck, but not when it is gone.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from pdcd.driver import DeviceLost, PdcdError

from ..guard import FROZEN_S, ShutterGuard
from .guardian import AGAIN_S, release_shutter

logger = logging.getLogger(__name__)

_ANSWER_S = 5.0
"""Longest time for the guardian's start and for each answer; both take milliseconds."""

SERIAL_GUARDIAN = (sys.executable, "-I", "-S", str(Path(__file__).with_name("guardian.py")))


class Watchdog(Protocol):
    """Ends an exposure that nothing else ends."""

    def arm(self, limit_s: float) -> None:
        """Release the shutter in `limit_s` seconds. Raises DeviceLost if that cannot be ensured."""
        ...

    def ended(self) -> str:
        """Why the watchdog ended the exposure for which it is armed; "" if it did not."""
        ...

    def disarm(self) -> str:
        """Stand down. Returns why the watchdog ended the exposure, "" if it did not; only once."""
        ...

    def stop(self) -> None:
        """Let go of all resources. Idempotent."""
        ...


class Guardian:
    """A process with the port's file descriptor; see `drivers.serial_shutter.guardian`."""

    def __init__(self, port_fd: int, how: str, value: str) -> None:
        def unguarded(why: str) -> None:
            self._ended = why
            if not release_shutter(port_fd, how, value):
                raise DeviceLost("the port does not take it", device="shutter")

        self._guard = ShutterGuard(
            (*SERIAL_GUARDIAN, str(port_fd), how, value),
            port_fd,
            answer_s=_ANSWER_S,
            unguarded=unguarded,
        )
        self._limit_s, self._ended = 0.0, ""
        self._guard.start()

    @property
    def pid(self) -> int | None:
        """Process id while it runs."""
        return self._guard.pid

    def arm(self, limit_s: float) -> None:
        """As the Protocol says; a guardian that died is replaced, also in mid-exposure."""
        self._limit_s, self._ended = limit_s, ""
        deadline_s = time.monotonic() + limit_s
        self._guard.arm(lambda: f"arm {max(0.0, deadline_s - time.monotonic())}")

    def ended(self) -> str:
        """As the Protocol says; a guardian that does not answer is replaced."""
        state = self._guard.ask("look")
        if not state:
            self._guard.look()
        return self._why(state) or self._ended

    def disarm(self) -> str:
        """As the Protocol says; a guardian that died counts as one that ended nothing."""
        why = self._why(self._guard.disarm())
        ended, self._ended = self._ended, ""
        return why or ended

    def stop(self) -> None:
        """End the process; it closes the shutter first if that is open."""
        self._guard.stop()

    def _why(self, state: bytes) -> str:
        """The guardian's answer in words; "" if it did not end the exposure."""
        if state == b"silent":
            return f"nothing was heard of the daemon for {FROZEN_S:g} s"
        return f"it lasted {self._limit_s:g} s" if state in (b"fired", b"lost") else ""


class Alarm:
    """A thread that calls `release` when the time is up, until it is told to stand down."""

    def __init__(self, release: Callable[[], None]) -> None:
        self._release = release
        self._timer: threading.Timer | None = None
        self._stand_down = threading.Event()
        self._limit_s, self._fired = 0.0, False

    def arm(self, limit_s: float) -> None:
        """As the Protocol says."""
        self.disarm()
        self._limit_s, self._fired = limit_s, False
        self._stand_down.clear()
        self._timer = threading.Timer(limit_s, self._end)
        self._timer.daemon = True
        self._timer.start()

    def ended(self) -> str:
        """As the Protocol says."""
        return f"it lasted {self._limit_s:g} s" if self._fired else ""

    def disarm(self) -> str:
        """As the Protocol says."""
        if self._timer is not None:
            self._timer.cancel()
            self._stand_down.set()
            self._timer.join()
            self._timer = None
        ended, self._fired = self.ended(), False
        return ended

    def stop(self) -> None:
        """End the thread."""
        self.disarm()

    def _end(self) -> None:
        self._fired = True
        while not self._stand_down.is_set():
            try:
                self._release()
            except PdcdError as err:
                logger.critical("watchdog cannot release device=shutter error=%s", err)
            self._stand_down.wait(AGAIN_S)
