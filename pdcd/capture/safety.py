"""Make both panels black and close the shutter, whatever state the devices are in."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager

from pdcd.bench.devices import Display, Shutter
from pdcd.bench.patience import Patience
from pdcd.errors import DeviceLost

logger = logging.getLogger(__name__)

_SAFE_TRIES, MAKE_SAFE_S = 3, 10.0
"""How often a failing device is asked to go black or to close, and for how long in total, before it
is given up: a job ends in time, whatever its devices do."""


def make_safe(display: Display, shutter: Shutter, patience: Patience) -> bool:
    """Make panels black, then close the shutter; returns whether both succeeded. Ignores cancels.

    A device that fails is asked again; what cannot be made safe is logged as critical.
    """
    black = _insist("display", display.black, patience)
    return _insist("shutter", shutter.close, patience) and black


def make_safe_beside(
    display: Display, shutter: Shutter, patience: Patience, within_s: float
) -> bool:
    """The same while another thread hangs in a call of a driver: both devices are asked at once,
    and waited for so long. A device that itself hangs is left to its guard."""
    safe: list[bool] = []

    def insist(name: str, action: Callable[[], object]) -> None:
        safe.append(_insist(name, action, patience))

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


def release_device(name: str, release: Callable[[], object], patience: Patience) -> None:
    """Release a device, within the same time, ignoring cancels; a failure is logged."""
    try:
        with patience.deaf(), _in_time(name, patience):
            release()
    except BaseException as err:
        logger.warning("not released device=%s error=%r", name, err)


def _insist(name: str, action: Callable[[], object], patience: Patience) -> bool:
    with patience.deaf(), _in_time(name, patience):
        for left in range(_SAFE_TRIES - 1, -1, -1):
            try:
                if left < _SAFE_TRIES - 1:
                    patience.look()  # whether there is time for another try
                action()
                return True
            except BaseException as err:  # one that ends programs opens no shutter
                level = logging.WARNING if left else logging.CRITICAL
                logger.log(level, "not safe device=%s error=%r tries_left=%d", name, err, left)
    return False


def _in_time(name: str, patience: Patience) -> AbstractContextManager[None]:
    def over() -> DeviceLost:
        return DeviceLost(f"took longer than {MAKE_SAFE_S:g} s", device=name, hint="see the log")

    return patience.within(MAKE_SAFE_S, over)
