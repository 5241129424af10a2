"""The process that ends a daemon which cannot do it itself: one whose interpreter a driver holds.

Started by `pdcd.server.ending` and run as a file by a bare interpreter (``-I -S``), so it imports
nothing of pdcd. The C library's part of a signal handler writes the signal's number to the line,
whatever Python is at. From then on the daemon has its time, and is killed after it: the kernel then
frees its devices, guardians close the shutter, and the presenter goes black.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import sys

_ENDS = frozenset({signal.SIGTERM, signal.SIGINT, signal.SIGHUP})


def keep_daemon(daemon: int, within_s: float, line: socket.socket) -> None:
    """Return when the process `daemon` has ended, if need be killed so long after such a signal."""
    process = os.pidfd_open(daemon)
    if os.getppid() != daemon:
        return  # it ended before it could be named
    told = b""
    while _ENDS.isdisjoint(told):
        try:
            told = line.recv(64)
        except OSError:
            told = b""
        if not told:
            return
    ended = select.poll()
    ended.register(process, select.POLLIN)
    if not ended.poll(within_s * 1000.0):
        signal.pidfd_send_signal(process, signal.SIGKILL)


if __name__ == "__main__":
    keep_daemon(int(sys.argv[1]), float(sys.argv[2]), socket.socket(fileno=int(sys.argv[3])))
