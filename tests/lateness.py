"""How late this machine itself is: a process keeps time beside a test and does next to nothing.

A test that counts lost refreshes needs a machine that lets a display process run when it is due.
Whether it does is measured, not guessed: each 60th of a second a process of the same scheduling
class wakes up, works for a millisecond of processor time, and notes when it was done. What is late
then is the machine, by other work, by its hypervisor, or by a processor that is throttled.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

LATE_S = 0.25 / 60.0
"""A quarter of a refresh: so late a display process lets the vblank go by."""

KEEPER = """
import os, select, sys, time

try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))
except OSError:
    pass

def work(count):
    begun_ns = time.thread_time_ns()
    for _ in range(count):
        pass
    return time.thread_time_ns() - begun_ns

def took_ns():
    return min(work(10_000) for _ in range(20))

count = 10_000 * 1_000_000 // max(took_ns(), 1)
worst_ns, due_ns = 0, time.monotonic_ns()
sys.stdout.write("ready\\n")
sys.stdout.flush()
while True:
    due_ns += 16_666_667
    left_s = max(0.0, (due_ns - time.monotonic_ns()) * 1e-9)
    if select.select([0], [], [], left_s)[0]:
        break
    work(count)
    late_ns = time.monotonic_ns() - due_ns - 1_000_000
    worst_ns = max(worst_ns, late_ns)
    if late_ns > 16_666_667:
        due_ns = time.monotonic_ns()
sys.stdout.write(f"{worst_ns}\\n")
"""


@dataclass
class Machine:
    """What the keeper of time has found; 0 until the block has ended."""

    worst_s: float = 0.0

    def quiet_or_skip(self, told: str) -> None:
        """Skip the test where the machine itself was late; else return, for the test to fail."""
        if self.worst_s > LATE_S:
            pytest.skip(f"THE MACHINE IS LATE (by {1e3 * self.worst_s:.1f} ms): {told}")


@contextmanager
def watched() -> Iterator[Machine]:
    """Keep time beside a block; what it yields knows afterwards how late the machine was."""
    found = Machine()
    with subprocess.Popen(
        [sys.executable, "-S", "-c", KEEPER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as keeper:
        assert keeper.stdout is not None and keeper.stdin is not None
        keeper.stdout.readline()
        try:
            yield found
        finally:
            keeper.stdin.close()
            found.worst_s = int(keeper.stdout.readline()) * 1e-9
