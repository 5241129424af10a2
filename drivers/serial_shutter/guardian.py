"""The process that releases the shutter when the daemon cannot: killed, crashed or stuck.

Started by `drivers.serial_shutter.watchdog` with the open port and one end of a socket pair; run
as a file by a bare interpreter (``-I -S``), so it imports nothing of pdcd. Words on the socket:

======== ==================== =====================================================
in       out                  meaning
======== ==================== =====================================================
arm S    ok                   release the shutter unless told otherwise within S seconds, and
                              every `AGAIN_S` from then on
disarm   ok, fired, lost,     the shutter is closed. The answer says whether this process closed it
         silent               since the last arm or disarm: ok: no; fired: time was up; silent:
                              the daemon was not heard; lost: it tried, and the port failed
look     the same             asks for the answer only; nothing changes
(end)                         the daemon is gone or done: release if armed, then end
======== ==================== =====================================================

The kernel closes the daemon's end however the daemon ends, so SIGKILL and segmentation faults
count as well. An armed guardian that hears nothing for `_FROZEN_S` takes the daemon for frozen: a
daemon that works speaks ten times a second. The guardian starts with all signals blocked
(`drivers.guard`); only SIGKILL ends it.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import socket
import struct
import sys
import termios
import time

_LINES = {"rts": termios.TIOCM_RTS, "dtr": termios.TIOCM_DTR}
AGAIN_S = 1.0
"""Once the time is up, the release is repeated at this interval until the daemon disarms. The port
may not have taken the first one, and a stopped daemon may send its command to open later."""
_FROZEN_S = 10.0
"""As in `drivers.guard`, which is not imported here."""
_TRIES = 3
_ROOM_MS = 500


def release_shutter(port: int, how: str, value: str) -> bool:
    """Close the shutter. Returns whether the port took it.

    Parameters
    ----------
    port
        File descriptor of the open port.
    how, value
        ``"rts"`` or ``"dtr"`` and the level of the closed shutter, ``"0"`` or ``"1"``; or
        ``"command"`` and the bytes to send, in hexadecimal.
    """
    left = bytes.fromhex(value) if how == "command" else b""
    for _ in range(_TRIES):
        try:
            while left:  # a port may take only a part of it
                left = left[os.write(port, left) :]
            if how != "command":
                action = termios.TIOCMBIS if value == "1" else termios.TIOCMBIC
                fcntl.ioctl(port, action, struct.pack("I", _LINES[how]))
            return True
        except BlockingIOError:  # its buffer is full of earlier bytes
            room = select.poll()
            room.register(port, select.POLLOUT)
            room.poll(_ROOM_MS)
        except OSError:
            continue
    return False


def run_serial_guardian(port: int, how: str, value: str, talk: socket.socket) -> None:
    """Serve until the other end of the socket is closed."""
    deadline_s: float | None = None
    heard_s, state, why = time.monotonic(), b"ok", b""
    while True:
        wait_s = None
        if deadline_s is not None:
            wait_s = max(0.0, min(deadline_s, heard_s + _FROZEN_S) - time.monotonic())
        if not select.select([talk], [], [], wait_s)[0]:
            why = why or (b"fired" if time.monotonic() >= (deadline_s or 0.0) else b"silent")
            state = why if release_shutter(port, how, value) else b"lost"
            deadline_s = heard_s = time.monotonic() + AGAIN_S
            continue
        heard_s = time.monotonic()
        try:
            word = talk.recv(64)
        except OSError:  # the daemon died with an answer unread
            word = b""
        if not word:
            if deadline_s is not None:
                release_shutter(port, how, value)
            return
        verb, _, seconds = word.decode("ascii").partition(" ")
        if verb == "arm":
            deadline_s, state, why = time.monotonic() + float(seconds), b"ok", b""
        elif verb == "disarm":
            deadline_s, why = None, b""
        with contextlib.suppress(OSError):
            talk.send(state)
        if verb == "disarm":
            state = b"ok"  # the answer is given once


if __name__ == "__main__":
    run_serial_guardian(
        int(sys.argv[1]), sys.argv[2], sys.argv[3], socket.socket(fileno=int(sys.argv[4]))
    )
