"""The process that ends a bulb exposure over libgphoto2 in its driver's place: see
`drivers.guarding`."""

from __future__ import annotations

import logging
import sys

import msgspec

from pdcd.driver import DeviceLost, RealClock

from ..guarding import run_camera_guardian
from .session import GphotoOptions, GphotoSession

logger = logging.getLogger(__name__)

_USER = "guardian"


def close_bulb(options: GphotoOptions) -> None:
    """Open the camera and end its exposure. Raises PdcdError when it cannot be opened."""
    session = GphotoSession(options, RealClock())
    try:
        session.open(_USER)
        try:
            session.set("bulb", 0)
        except DeviceLost as err:
            if not session.is_open:
                raise
            logger.warning("the camera says that it holds no exposure error=%s", err)
    finally:
        session.close(_USER)


def run_gphoto_guardian(options: str, fd: int) -> int:
    """Guard with options as JSON; returns an exit status."""
    given = msgspec.json.decode(options, type=GphotoOptions)
    return run_camera_guardian(fd, lambda: close_bulb(given))


if __name__ == "__main__":
    sys.exit(run_gphoto_guardian(sys.argv[1], int(sys.argv[2])))
