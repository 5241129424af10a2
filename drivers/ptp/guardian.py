"""The process that closes the camera's shutter when the one that opened it is gone.

A bulb exposure over USB goes on until somebody ends it, and a process that is killed ends nothing.
This one is started by `drivers.ptp.shutter` with one end of a socket pair (`drivers.guard`), and
does not touch the camera, which is its parent's alone, as long as the other end is there:

======== ======= ======================================================
in       out     meaning
======== ======= ======================================================
arm      ok      the shutter may be open from now on
disarm   ok      it is surely closed
look     ok      nothing changes
(end)            the parent is gone or done: close it if armed, then end
======== ======= ======================================================

The kernel closes the parent's end however that ends, and frees the camera, on which a new session
begins with a closed shutter (`drivers.ptp.bulb`). This process is born with all signals blocked.
"""

from __future__ import annotations

import logging
import sys
import time
from contextlib import suppress

import msgspec

from pdcd.child import WORDS, LineClosedError, MessageLine
from pdcd.driver import PdcdError, RealClock

from .eos import EosCamera
from .options import PtpOptions

logger = logging.getLogger(__name__)

TRY_S = 60.0
"""How long the camera is tried: another program may be quicker to take hold of it."""
_AGAIN_S = 0.2
_USER = "guardian"


def serve_guardian(line: MessageLine[bytes], options: PtpOptions, backend: object = None) -> bool:
    """Answer until the other end is gone; returns whether the shutter is closed then.

    `backend` is a pyusb backend; None takes the machine's libusb.
    """
    armed = False
    while True:
        try:
            word = line.receive()
        except LineClosedError:
            return not armed or close_shutter(options, backend)
        if word != b"look":
            armed = word == b"arm"
        with suppress(LineClosedError):  # the last word is heard all the same
            line.send("ok")


def close_shutter(options: PtpOptions, backend: object) -> bool:
    """Begin a session with the camera, which closes the shutter, and end it."""
    camera = EosCamera(options, RealClock(), backend, TRY_S)
    until_s = time.monotonic() + TRY_S
    while True:
        try:
            camera.open(_USER)
        except PdcdError as err:
            if time.monotonic() > until_s:
                logger.critical("shutter may be open error=%s", err)
                return False
            time.sleep(_AGAIN_S)
            continue
        logger.warning("shutter closed in place of a process that is gone")
        camera.let_go(_USER)
        return True


def run_ptp_guardian(options: str, fd: int, backend: object = None) -> int:
    """`serve_guardian` with options as JSON; returns an exit status."""
    with MessageLine.at(fd, WORDS) as line:
        closed = serve_guardian(line, msgspec.json.decode(options, type=PtpOptions), backend)
    return 0 if closed else 1


if __name__ == "__main__":
    sys.exit(run_ptp_guardian(sys.argv[1], int(sys.argv[2])))
