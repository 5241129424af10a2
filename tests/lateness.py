"""How late this machine itself is: a process that keeps time on each of its cores beside a test.

A test that counts lost refreshes needs a machine that lets a display process run when it is due.
Whether it does is measured, not guessed: on each core a thread that nothing outranks, where that is
permitted, wakes up every 2 ms and notes how late that was. What is late then is the machine, by a
hypervisor that took the core away, or by a bound on processor time.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

LATE_S = 0.5 / 60.0
"""Half a refresh. Of 24 passes of 300 refreshes on a busy virtual machine, 16 lost some: in each of
them a core was away for 17 ms or more, in each of the others for 7 ms or less."""

KEEPER = """
import os, sys, threading, time

STEP_NS = 2_000_000
cores = sorted(os.sched_getaffinity(0))
worst_ns = dict.fromkeys(cores, 0)
done = False

def keep(core):
    os.sched_setaffinity(0, {core})
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(90))
    except OSError:
        pass
    due_ns = time.monotonic_ns()
    while not done:
        due_ns += STEP_NS
        time.sleep(max(0, due_ns - time.monotonic_ns()) * 1e-9)
        now_ns = time.monotonic_ns()
        worst_ns[core] = max(worst_ns[core], now_ns - due_ns)
        due_ns = max(due_ns, now_ns - STEP_NS)

threads = [threading.Thread(target=keep, args=(core,)) for core in cores]
for thread in threads:
    thread.start()
print("ready", flush=True)
sys.stdin.read()
done = True
for thread in threads:
    thread.join()
print(max(worst_ns.values()))
"""


@dataclass
class Machine:
    """What the keepers of time have found; 0 until the block has ended.

    pid : their process, for a test that stops it."""

    pid: int
    worst_s: float = 0.0

    def quiet_or_skip(self, told: str) -> None:
        """Skip the test where the machine itself was late; else return, for the test to fail."""
        if self.worst_s > LATE_S:
            pytest.skip(f"THE MACHINE IS LATE (by {1e3 * self.worst_s:.1f} ms): {told}")


@contextmanager
def watched() -> Iterator[Machine]:
    """Keep time beside a block; what it yields knows afterwards how late the machine was."""
    with subprocess.Popen(
        [sys.executable, "-S", "-c", KEEPER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as keeper:
        assert keeper.stdout is not None and keeper.stdin is not None
        keeper.stdout.readline()
        found = Machine(keeper.pid)
        try:
            yield found
        finally:
            keeper.stdin.close()
            found.worst_s = int(keeper.stdout.readline()) * 1e-9
