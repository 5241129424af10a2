"""The process that closes a camera's shutter when the one that opened it is gone, or frozen.

A bulb exposure over USB goes on until it is ended, and a killed process ends nothing. This process
is started by a shutter's driver with one end of a socket pair (`drivers.guard`). While its parent
lives, it does not touch the camera, which only the parent uses:

======== ======= ======================================================
in       out     meaning
======== ======= ======================================================
arm      ok      the shutter may be open from now on
disarm   ok      it is surely closed
look     ok      nothing changes
(none)           armed, and no word for `FROZEN_S`: kill the parent, which holds the camera
(end)            the parent is gone or done: close it if armed, then end
======== ======= ======================================================

The kernel closes the parent's end however the parent ends, and frees the camera. This process
starts with all signals blocked.
"""

from __future__ import annotations

import logging
import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress

from pdcd.child import WORDS, LineClosedError, LineSilentError, MessageLine
from pdcd.driver import PdcdError

from .guard import FROZEN_S

logger = logging.getLogger(__name__)

TRY_S = 60.0
"""How long to try to open the camera: another program may be quicker."""
_AGAIN_S = 0.2
_AWAKE_S = 1.0
"""Time for the parent to send a word once this process is awake, as both may have been frozen."""


def run_camera_guardian(fd: int, close: Callable[[], object]) -> int:
    """Guard over the line at a descriptor; returns an exit status.

    `close()` closes the shutter of a camera that is free, and raises PdcdError when it cannot.
    """
    parent = os.pidfd_open(os.getppid())
    with MessageLine.at(fd, WORDS) as line:
        closed = serve_guardian(
            line, close, lambda: signal.pidfd_send_signal(parent, signal.SIGKILL)
        )
    return 0 if closed else 1


def serve_guardian(
    line: MessageLine[bytes], close: Callable[[], object], end_parent: Callable[[], object]
) -> bool:
    """Answer until the other end is gone; returns whether the shutter is closed then."""
    armed = False
    while True:
        try:
            word = line.receive(within_s=FROZEN_S if armed else None)
        except LineSilentError:
            if line.wait(_AWAKE_S):
                continue  # both were frozen, and are awake again
            logger.critical("shutter open, and nothing heard for %g s: killing", FROZEN_S)
            end_parent()
            continue  # next comes the end of the line
        except LineClosedError:
            return not armed or try_to_close(close)
        if word != b"look":
            armed = word == b"arm"
        with suppress(LineClosedError):  # the end of the line is noticed anyway
            line.send("ok")


def try_to_close(close: Callable[[], object]) -> bool:
    """Try for a minute; returns whether the shutter is closed."""
    until_s = time.monotonic() + TRY_S
    while True:
        try:
            close()
        except PdcdError as err:
            if time.monotonic() > until_s:
                logger.critical("shutter may be open error=%s", err)
                return False
            time.sleep(_AGAIN_S)
            continue
        logger.warning("shutter closed in place of a process that is gone")
        return True
