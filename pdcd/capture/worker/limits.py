"""What a work process may do: take so much memory, live no longer than its parent, be killed."""

from __future__ import annotations

import ctypes
import resource
import signal
from contextlib import suppress
from pathlib import Path

PR_SET_PDEATHSIG = 1
"""Of sys/prctl.h: the signal that comes when the parent's thread that started this process ends."""
FIRST_VICTIM = "500"
"""For oom_score_adj: where the machine itself runs out of memory, this goes before the daemon."""


def confine() -> None:
    """Bound the life of this process, before it does anything else."""
    # The daemon decides when this ends: a Ctrl-C in its terminal is not for here, nor is the signal
    # that systemd sends to all processes of a service.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    # While it works it does not look at its socket: the kernel must tell it that it is alone.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(FIRST_VICTIM)


def bound_memory(limit_bytes: int) -> None:
    """Let this process have so much memory, for good."""
    # Data, not addresses: libraries reserve addresses by the gigabyte that they never touch.
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = limit_bytes if hard == resource.RLIM_INFINITY else min(limit_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
