"""Both panels black and the shutter closed, whatever state the devices are in."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from pdcd.bench.devices import Display, Shutter
from pdcd.bench.patience import Patience

logger = logging.getLogger(__name__)

_SAFE_TRIES = 3
"""How often a device that fails is asked to go black or to close before it is given up."""


def make_safe(display: Display, shutter: Shutter, patience: Patience) -> bool:
    """Panels black, then the shutter closed; whether both are. Hears no cancel.

    A device that fails is asked again; what cannot be made safe is logged as critical.
    """
    with patience.deaf():
        black = _insist("display", display.black)
        return _insist("shutter", shutter.close) and black


def make_safe_beside(
    display: Display, shutter: Shutter, patience: Patience, within_s: float
) -> bool:
    """The same, beside a thread that hangs in a call of a driver: both at a time, and waited for so
    long. A device that hangs itself is left to whoever guards it."""
    safe: list[bool] = []

    def insist(name: str, action: Callable[[], object]) -> None:
        with patience.deaf():
            safe.append(_insist(name, action))

    asked = [
        threading.Thread(target=insist, args=args, daemon=True)
        for args in (("display", display.black), ("shutter", shutter.close))
    ]
    for thread in asked:
        thread.start()
    until_s = time.monotonic() + within_s
    for thread in asked:
        thread.join(max(0.0, until_s - time.monotonic()))
    return safe == [True, True]


def _insist(name: str, action: Callable[[], object]) -> bool:
    for left in range(_SAFE_TRIES - 1, -1, -1):
        try:
            action()
            return True
        except BaseException as err:  # one that ends programs opens no shutter
            level = logging.WARNING if left else logging.CRITICAL
            logger.log(level, "not safe device=%s error=%r tries_left=%d", name, err, left)
    return False
