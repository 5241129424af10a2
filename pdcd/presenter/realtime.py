"""Keep the operating system from delaying the loop, as far as it permits."""

from __future__ import annotations

import ctypes
import gc
import os
import signal

MCL_CURRENT_AND_FUTURE = 3
"""MCL_CURRENT | MCL_FUTURE of sys/mman.h."""


def raise_priority(priority: int) -> str:
    """Ask for SCHED_FIFO; returns what came of it, in words for the run's record.

    Threads that are made later inherit it: call this before the GL context.
    """
    if not priority:
        return "no: not asked for"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as err:
        return f"no: {err.strerror}; the service needs LimitRTPRIO={priority}"
    return f"SCHED_FIFO {priority}"


def lock_memory() -> str:
    """Keep every page in memory; returns what came of it."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT_AND_FUTURE):
        reason = os.strerror(ctypes.get_errno())
        return f"no: {reason}; the service needs LimitMEMLOCK=infinity"
    return "yes"


def freeze_garbage() -> None:
    """No collection runs from here on; what lives now is never looked at again."""
    gc.collect()
    gc.disable()
    gc.freeze()


def dead_mans_switch(seconds: float) -> None:
    """End this process unless called again within that time; 0 disarms.

    The kernel does it, so a loop that hangs inside a library goes too: its windows vanish with it
    and the screen's black background shows. Needed when nobody is left to kill it.
    """
    signal.setitimer(signal.ITIMER_REAL, seconds)
