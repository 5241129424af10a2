"""The process that closes the shutter of an EOS body in its driver's place: see `drivers.guarding`.

A session with the camera begins with a closed shutter (`drivers.ptp.bulb`).
"""

from __future__ import annotations

import sys

import msgspec

from pdcd.driver import RealClock

from ..guarding import TRY_S, run_camera_guardian
from .eos import EosCamera
from .options import PtpOptions

_USER = "guardian"


def close_eos(options: PtpOptions, backend: object = None) -> None:
    """Begin a session with the camera and end it; `backend` is pyusb's, None the machine's libusb.

    Raises PdcdError when no camera can be opened.
    """
    camera = EosCamera(options, RealClock(), backend, TRY_S)
    camera.open(_USER)
    camera.let_go(_USER)


def run_ptp_guardian(options: str, fd: int, backend: object = None) -> int:
    """Guard with options as JSON; returns an exit status."""
    given = msgspec.json.decode(options, type=PtpOptions)
    return run_camera_guardian(fd, lambda: close_eos(given, backend))


if __name__ == "__main__":
    sys.exit(run_ptp_guardian(sys.argv[1], int(sys.argv[2])))
