"""Communication with the service manager: readiness, status, watchdog, passed sockets.

The protocols of sd_notify(3), sd_watchdog_enabled(3) and sd_listen_fds(3), without a library: each
is a few lines. Outside systemd all of this does nothing.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Mapping

from pdcd.printable import to_one_line

logger = logging.getLogger(__name__)

FIRST_FD = 3
"""File descriptor at which passed sockets begin (SD_LISTEN_FDS_START)."""


class Notifier:
    """Sends state lines such as ``READY=1`` to the address in NOTIFY_SOCKET, if there is one."""

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        # A leading @ stands for the abstract namespace, which the kernel marks by a zero byte.
        self._address = "\0" + address[1:] if address.startswith("@") else address

    def send(self, *lines: str) -> None:
        """Send the lines as one datagram. A manager that is gone is logged, not an error."""
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
                # The manager reads slowly at times; the event loop must not wait for it.
                sock.setblocking(False)
                sock.sendto("\n".join(map(to_one_line, lines)).encode(), self._address)
        except OSError as err:
            logger.warning("notify failed lines=%r error=%s", lines, err)


def watchdog_s(environ: Mapping[str, str] = os.environ) -> float | None:
    """Time in seconds within which the manager wants a sign of life; None if it wants none."""
    if environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    usec = environ.get("WATCHDOG_USEC", "")
    return int(usec) / 1e6 if usec.isdecimal() and int(usec) > 0 else None


def count_listen_fds(environ: Mapping[str, str] = os.environ) -> int:
    """How many sockets were passed to this process, from `FIRST_FD` on; 0 if none.

    LISTEN_PID guards against a variable that was merely inherited from a parent.
    """
    if environ.get("LISTEN_PID") != str(os.getpid()):
        return 0
    count = environ.get("LISTEN_FDS", "")
    return int(count) if count.isdecimal() else 0
