"""A work process is born: started on one end of a socket pair. Imports nothing heavy, so that
`pdcd serve` can have one import while it does so itself."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from pdcd.errors import PdcdError

COMMAND = (sys.executable, "-P", "-m", "pdcd.capture.worker")
"""With -P no module of the current folder is taken for one of ours."""


@dataclass(frozen=True)
class Newborn:
    """A work process that knows nothing yet, and this end of the socket to it."""

    process: subprocess.Popen[bytes]
    talk: socket.socket

    def end(self) -> None:
        """Kill it, if nobody did, and close the socket. Idempotent."""
        self.process.kill()
        self.process.wait()
        self.talk.close()


def born(command: Sequence[str] = COMMAND) -> Newborn:
    """Start a work process, without waiting until it is warm. Raises PdcdError.

    The kernel ends it with the thread that calls this.
    """
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    with theirs:
        try:
            process = subprocess.Popen(
                [*command, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                # A session of its own: the terminal's Ctrl-C and hang-up are not for it.
                start_new_session=True,
                # More threads of the linear algebra gain nothing on arrays of this size, and
                # each takes of the memory that the process may have.
                env={"OMP_NUM_THREADS": "1", **os.environ},
            )
        except OSError as err:
            ours.close()
            raise PdcdError(
                f"cannot start the process that plans and decodes: {err.strerror}",
                hint="see the log; too many processes, or too little memory?",
            ) from err
    ours.setblocking(False)
    return Newborn(process, ours)
