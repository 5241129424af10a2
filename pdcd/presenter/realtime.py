"""Keep the operating system from delaying the loop, as far as it permits."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
from pathlib import Path

_MCL_TOUCHED = 1 | 2 | 4
"""MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT of sys/mman.h."""


def raise_priority(priority: int) -> str:
    """Ask for SCHED_FIFO for all threads of this process; returns what came of it, in words for
    the run's record.

    Call this when the windows are open: GLFW waits for them to appear without letting go of the
    processor, which would keep it from the very server that it waits for. The GL driver has made
    its threads by then, so they are all asked for; later ones inherit it.
    """
    if not priority:
        return "no: not asked for"
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))
    except OSError as err:
        return f"no: {err.strerror}; the service needs LimitRTPRIO={priority}"
    return f"SCHED_FIFO {priority}"


def lock_memory() -> str:
    """Keep every page that is used in memory; returns what came of it.

    Pages that were never touched stay out: with them a killed process takes a tenth of a second to
    die, and its windows stay lit for so long.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_TOUCHED):
        reason = os.strerror(ctypes.get_errno())
        return f"no: {reason}; the service needs LimitMEMLOCK=infinity"
    return "yes"


def stop_garbage_collection() -> None:
    """No collection runs from here on; what lives now is never looked at again."""
    gc.collect()
    gc.disable()
    gc.freeze()


def arm_dead_mans_switch(seconds: float) -> None:
    """End this process unless called again within that time; 0 disarms.

    The kernel does it, so a loop that hangs inside a library goes too: its windows vanish with it
    and the screen's black background shows. Needed when nobody is left to kill it.
    """
    signal.setitimer(signal.ITIMER_REAL, seconds)
