"""A thread that keeps a connected camera awake, reads its events and watches its bulb exposure."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from pdcd.driver import PdcdError

logger = logging.getLogger(__name__)

PERIOD_S = 2.0
"""Time between two signs of life; cameras switch themselves off after 30 s at the earliest."""


class KeepAlive:
    """Calls `tick` every period, in a thread of its own, until stopped.

    The period is real time, whatever clock the rig runs on. `tick` must not wait for long.
    """

    def __init__(self, tick: Callable[[], None], period_s: float) -> None:
        self._tick = tick
        self._period_s = period_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pdcd-ptp-alive", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread; it has ended on return."""
        self._stop.set()
        # A finaliser may come here from within `tick`, in the thread itself.
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(self._period_s):
            try:
                self._tick()
            except PdcdError as err:  # the next user of the camera gets and reports the same error
                logger.warning("camera not kept awake error=%s", err)
