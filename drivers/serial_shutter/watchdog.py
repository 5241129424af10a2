"""Who releases the shutter line when the driver does not get to it.

A port of this machine gets a `Guardian`: a process that outlives the daemon and shares no lock with
it. A port without a file descriptor (rfc2217 and the like) cannot be handed to another process and
gets an `Alarm`: a thread, which helps against a daemon that is stuck, not against one that is gone.
"""

from __future__ import annotations

import logging
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from pdcd.errors import DeviceLost, PdcdError

logger = logging.getLogger(__name__)

_ANSWER_S = 5.0
"""Bound of the guardian's start and of each of its answers; both take milliseconds."""

GUARDIAN = (sys.executable, "-I", "-S", str(Path(__file__).with_name("guardian.py")))


class Watchdog(Protocol):
    """Ends an exposure that nobody else ends."""

    def arm(self, limit_s: float) -> None:
        """Release the shutter in `limit_s` seconds. Raises DeviceLost if nobody will."""
        ...

    def disarm(self) -> bool:
        """Stand down; returns whether the exposure was ended by the watchdog."""
        ...

    def stop(self) -> None:
        """Let go of all resources. Idempotent."""
        ...


class Guardian:
    """A process with the port's file descriptor; see `drivers.serial_shutter.guardian`."""

    def __init__(self, port_fd: int, how: str, value: str) -> None:
        self._task = (port_fd, how, value)
        self._talk: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._start()

    @property
    def pid(self) -> int | None:
        """Process id while it runs."""
        return None if self._process is None else self._process.pid

    def arm(self, limit_s: float) -> None:
        """As the Protocol says; a guardian that died is replaced."""
        if not self._ask(f"arm {limit_s}"):
            logger.warning("guardian replaced device=shutter")
            self.stop()
            self._start()
            if not self._ask(f"arm {limit_s}"):
                raise DeviceLost(
                    "the process that guards the shutter does not start",
                    device="shutter",
                    hint="see the log; too many processes?",
                )

    def disarm(self) -> bool:
        """As the Protocol says; a guardian that died has done nothing."""
        return self._ask("disarm") in (b"fired", b"lost")

    def stop(self) -> None:
        """End the process; it releases the shutter first if it is armed."""
        if self._talk is not None:
            self._talk.close()
            self._talk = None
        if self._process is not None:
            try:
                self._process.wait(_ANSWER_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._process = None

    def _start(self) -> None:
        port_fd, how, value = self._task
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [*GUARDIAN, str(port_fd), str(theirs.fileno()), how, value]
        with theirs:
            try:
                self._process = subprocess.Popen(
                    command,
                    pass_fds=(port_fd, theirs.fileno()),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    start_new_session=True,
                )
            except OSError as err:
                ours.close()
                raise DeviceLost(
                    f"cannot start the process that guards the shutter: {err.strerror}",
                    device="shutter",
                    hint="see the log; too many processes?",
                ) from err
        ours.settimeout(_ANSWER_S)
        self._talk = ours

    def _ask(self, word: str) -> bytes:
        """The answer; b"" when there is none."""
        if self._talk is not None:
            with suppress(OSError):  # it died, or does not answer in time
                self._talk.send(word.encode("ascii"))
                return self._talk.recv(64)
        return b""


class Alarm:
    """A thread that calls `release` when the time is up."""

    def __init__(self, release: Callable[[], None]) -> None:
        self._release = release
        self._timer: threading.Timer | None = None
        self._fired = False

    def arm(self, limit_s: float) -> None:
        """As the Protocol says."""
        self.disarm()
        self._fired = False
        self._timer = threading.Timer(limit_s, self._end)
        self._timer.daemon = True
        self._timer.start()

    def disarm(self) -> bool:
        """As the Protocol says."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer.join()
            self._timer = None
        return self._fired

    def stop(self) -> None:
        """End the thread."""
        self.disarm()

    def _end(self) -> None:
        self._fired = True
        try:
            self._release()
        except PdcdError as err:
            logger.critical("watchdog cannot release device=shutter error=%s", err)
