"""The process that ends a daemon which cannot end itself, because a driver holds its interpreter.

It is started by `pdcd.server.ending` and run as a file by a bare interpreter (``-I -S``), so it
imports nothing of pdcd. The C library's part of a signal handler writes the signal's number to the
line, whatever Python is doing. The daemon is killed a fixed time after that: the kernel then frees
its devices, guardians close the shutter, and the presenter goes black.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import sys

_ENDS = frozenset({signal.SIGTERM, signal.SIGINT, signal.SIGHUP})


def keep_daemon(daemon: int, within_s: float, line: socket.socket) -> None:
    """Return when the process `daemon` has ended; after such a signal it is killed if it takes
    longer than that."""
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
