"""A process beside this one that closes the shutter when this one cannot, and the talk with it.

What it does then is the business of the driver that has it: `drivers.serial_shutter.guardian` and
`drivers.ptp.guardian`. The talk is words and answers on a socket pair. The kernel closes this end
however this process ends, and that end is the last word.
"""

from __future__ import annotations

import logging
import socket
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress

from pdcd.errors import DeviceLost

logger = logging.getLogger(__name__)

_END_S = 5.0
"""Bound of the end of a guardian that has little left to do."""
_at_work: list[subprocess.Popen[bytes]] = []
"""Those that nobody waits for."""


class Guard:
    """One such process, from `start` or the first `insist` on.

    command : what to run, by the number of its end of the socket pair.
    inherits : further file descriptors that it gets.
    answer_s : bound of each of its answers, the first with its start.

    Not for use from two threads at once.
    """

    def __init__(
        self, command: Callable[[int], Sequence[str]], *inherits: int, answer_s: float
    ) -> None:
        self._command, self._inherits, self._answer_s = command, inherits, answer_s
        self._talk: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """Process id while it runs."""
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        """Start the process. Raises DeviceLost when that cannot be done."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            try:
                self._process = subprocess.Popen(
                    self._command(theirs.fileno()),
                    pass_fds=(*self._inherits, theirs.fileno()),
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
        ours.settimeout(self._answer_s)
        self._talk = ours

    def ask(self, word: str) -> bytes:
        """The answer; b"" when there is none."""
        if self._talk is not None:
            with suppress(OSError):  # it died, or does not answer in time
                self._talk.send(word.encode("ascii"))
                return self._talk.recv(64)
        return b""

    def insist(self, word: str) -> None:
        """Say it to one that hears, and replaces one that died. Raises DeviceLost if none does."""
        if not self.ask(word):
            if self._process is not None:
                logger.warning("guardian replaced device=shutter")
            self.stop()
            self.start()
            if not self.ask(word):
                raise DeviceLost(
                    "the process that guards the shutter does not start",
                    device="shutter",
                    hint="see the log; too many processes?",
                )

    def stop(self, *, wait: bool = True) -> None:
        """End the process; it closes the shutter first if that is open. Idempotent."""
        if self._talk is not None:
            self._talk.close()
            self._talk = None
        process, self._process = self._process, None
        if process is None:
            return
        if not wait:
            _at_work.append(process)
            return
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
