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
    """Ask for SCHED_FIFO for all threads of this process; returns the outcome, in words for the
    run's record.

    Call this when the windows are open: GLFW waits for them to appear without releasing the
    processor, and in real time would starve the very server that it waits for. The GL driver has
    made its threads by then, so they get the class, too; later ones inherit it.
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
    """Keep every page that is used in memory; returns the outcome in words.

    Pages that were never touched are not locked: with them a killed process takes a tenth of a
    second to die, and its windows stay lit that long.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_TOUCHED):
        reason = os.strerror(ctypes.get_errno())
        return f"no: {reason}; the service needs LimitMEMLOCK=infinity"
    return "yes"


def stop_garbage_collection() -> None:
    """No collection runs from now on; objects that exist now are never examined again."""
    gc.collect()
    gc.disable()
    gc.freeze()


def arm_dead_mans_switch(seconds: float) -> None:
    """End this process unless called again within that time; 0 disarms.

    The kernel does it, so it also ends a loop that hangs inside a library: its windows vanish with
    it and the screen's black background shows. It is needed when the driver is gone and cannot kill
    the process.
    """
    signal.setitimer(signal.ITIMER_REAL, seconds)
