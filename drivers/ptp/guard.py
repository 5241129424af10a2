"""A process beside this one that closes the shutter should this one be killed.

See `drivers.ptp.guardian`, which is that process.
"""

from __future__ import annotations

import logging
import select
import subprocess
import sys
from contextlib import suppress

import msgspec

from drivers.ptp.guardian import CLOSED, OPEN
from drivers.ptp.options import PtpOptions
from pdcd.errors import DeviceLost

logger = logging.getLogger(__name__)

COMMAND: tuple[str, ...] = (sys.executable, "-m", "drivers.ptp.guardian")
"""Runs it; the options of the camera follow."""

_READY_S = 20.0
"""Longest wait for a new one, which takes half a second."""
_END_S = 5.0
"""Longest wait for the end of one that has nothing to do."""
_at_work: list[subprocess.Popen[bytes]] = []
"""Those that were left with something to do."""


class Guard:
    """One guardian process, for one camera. Not for use from two threads at once."""

    def __init__(self, options: PtpOptions) -> None:
        self._options = options
        self._process: subprocess.Popen[bytes] | None = None
        self._told = CLOSED

    @property
    def pid(self) -> int | None:
        """Process id while there is one."""
        return None if self._process is None else self._process.pid

    def watch(self, serial: str) -> None:
        """Be there for the camera of that serial number, whose shutter is closed.

        Raises DeviceLost when no process can be started.
        """
        self._told = CLOSED
        if serial == self._options.serial and self._send():
            return
        self.stop()
        self._options = msgspec.structs.replace(self._options, serial=serial)
        self._start()

    def tell(self, *, may_be_open: bool) -> None:
        """Say whether the shutter may be open. A guardian that died is replaced.

        Raises DeviceLost when that fails and there is something to guard.
        """
        self._told = OPEN if may_be_open else CLOSED
        if self._send() or not may_be_open:
            return
        logger.warning("guardian replaced device=shutter")
        self._told = CLOSED
        self.stop()
        self._start()
        self._told = OPEN
        if not self._send():
            raise _unguarded("it ended at once")

    def stop(self) -> None:
        """Let the guardian end. One that has a shutter to close does so, and is not waited for."""
        process, self._process = self._process, None
        if process is None:
            return
        if process.stdin is not None:
            with suppress(OSError):
                process.stdin.close()
        if self._told == OPEN:
            _at_work.append(process)
            return
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _start(self) -> None:
        options = msgspec.json.encode(self._options).decode()
        try:
            process = subprocess.Popen(
                [*COMMAND, options],
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,
            )
        except OSError as err:
            raise _unguarded(err.strerror or "") from err
        self._process = process
        if not _is_ready(process):
            process.kill()
            self._told = CLOSED
            self.stop()
            raise _unguarded("it does not say that it is ready")

    def _send(self) -> bool:
        process = self._process
        if process is None or process.stdin is None or process.poll() is not None:
            return False
        try:
            process.stdin.write(self._told)
        except OSError:
            return False
        return True


def _is_ready(process: subprocess.Popen[bytes]) -> bool:
    """Whether it says so in time."""
    if process.stdout is None:
        return False
    with process.stdout as says:
        return bool(select.select([says], [], [], _READY_S)[0] and says.read(1))


def _unguarded(why: str) -> DeviceLost:
    return DeviceLost(
        f"the process that guards the shutter does not start: {why}",
        device="shutter",
        hint="see the log; too many processes?",
    )
