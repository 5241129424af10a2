"""Waits for processes that are no children of the tests, and looks at them."""

from __future__ import annotations

import os
import select
import signal
import time
from collections.abc import Callable
from pathlib import Path

LONG_S = 60.0
"""Bound of a wait for another process; it takes milliseconds when the machine is free."""


def ended(pid: int) -> bool:
    """Whether a process that is no child of ours ends within the bound."""
    try:
        watched = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([watched], [], [], LONG_S)[0])
    finally:
        os.close(watched)


def read_rss_mib(pid: int) -> float:
    """Resident memory of a process alone, in MiB."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024.0


def send_every_signal(pid: int) -> None:
    """Send a process all signals that it can do something about: all but SIGKILL and SIGSTOP."""
    for number in sorted(signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}):
        os.kill(pid, number)


def soon(true: Callable[[], bool]) -> bool:
    """Whether that becomes true within the bound."""
    until_s = time.monotonic() + LONG_S
    while not true():  # asked once each time: it may not stay true
        if time.monotonic() > until_s:
            return False
        time.sleep(0.005)
    return True
