"""Time that a machine had: what its host withholds from a virtual one is no program's fault.

Such time comes in pieces of seconds on a host that is shared; nobody can keep a promise in it.
"""

from __future__ import annotations

import os
import time
from pathlib import Path


def stolen_s() -> float:
    """Seconds that the host withheld from the machine so far, the mean of all processors."""
    words = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
    return int(words[8]) / os.sysconf("SC_CLK_TCK") / (os.cpu_count() or 1)


class Lapse:
    """Time since it was made."""

    def __init__(self) -> None:
        self._begun_s, self._stolen_s = time.monotonic(), stolen_s()

    @property
    def whole_s(self) -> float:
        """Seconds by the clock."""
        return time.monotonic() - self._begun_s

    @property
    def own_s(self) -> float:
        """Seconds that the machine itself had of them."""
        return max(0.0, self.whole_s - (stolen_s() - self._stolen_s))
