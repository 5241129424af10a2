"""The two clocks a rig can run on."""

from __future__ import annotations

import time


class RealClock:
    """The machine's monotonic clock."""

    def now_ns(self) -> int:
        """Nanoseconds since boot."""
        return time.monotonic_ns()

    def sleep_until_ns(self, t_ns: int) -> None:
        """Sleep until that time; at once if it has passed."""
        left_ns = t_ns - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns * 1e-9)


class VirtualClock:
    """A clock that nobody waits for: sleeping advances it. For the mock bench only.

    It always starts at the same time, so that runs with the same seeds are identical to the bit.
    """

    def __init__(self) -> None:
        self._now_ns = 1_000_000_000

    def now_ns(self) -> int:
        """Nanoseconds: one second, plus all that was slept."""
        return self._now_ns

    def sleep_until_ns(self, t_ns: int) -> None:
        """Jump to that time; do nothing if it has passed."""
        self._now_ns = max(self._now_ns, t_ns)
