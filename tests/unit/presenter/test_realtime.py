"""What the display process asks of the operating system, and what ends it when it hangs."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import subprocess
import sys
import threading

import pytest

from pdcd.presenter import realtime
from tests.places import ROOT


def child(code: str) -> subprocess.CompletedProcess[str]:
    """A process of its own: these calls change the whole of one, or end it."""
    return subprocess.run(
        [sys.executable, "-c", f"import time\nfrom pdcd.presenter import realtime\n{code}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=50.0,
    )


def test_a_process_that_hangs_is_ended_by_the_kernel() -> None:
    done = child("realtime.arm_dead_mans_switch(0.2)\ntime.sleep(40.0)\nprint('alive')")
    assert done.returncode == -signal.SIGALRM
    assert done.stdout == ""


def test_it_lives_as_long_as_it_is_called_again_and_when_disarmed() -> None:
    calls = "for _ in range(4):\n realtime.arm_dead_mans_switch(30.0)\n time.sleep(0.05)\n"
    done = child(f"{calls}realtime.arm_dead_mans_switch(0.2)\nrealtime.arm_dead_mans_switch(0.0)\n"
                 "time.sleep(0.5)\nprint('alive')")  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "alive\n")


class Scheduler:
    """Takes note of what is asked of it, and may refuse."""

    def __init__(self, refusal: OSError | None = None) -> None:
        self.asked: list[tuple[int, int, int]] = []
        self.refusal = refusal

    def __call__(self, thread: int, policy: int, parameters: os.sched_param) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.asked.append((thread, policy, parameters.sched_priority))


def test_every_thread_is_given_the_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    scheduler = Scheduler()
    monkeypatch.setattr(os, "sched_setscheduler", scheduler)
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    try:
        assert realtime.raise_priority(7) == "SCHED_FIFO 7"
        assert thread.native_id is not None
        threads = {number for number, _, _ in scheduler.asked}
        assert {os.getpid(), thread.native_id} <= threads
    finally:
        done.set()
        thread.join()
    assert {asked[1:] for asked in scheduler.asked} == {(os.SCHED_FIFO, 7)}


def test_none_is_asked_for_where_none_is_wanted_and_a_refusal_has_its_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refusal = PermissionError(errno.EPERM, "Operation not permitted")
    monkeypatch.setattr(os, "sched_setscheduler", Scheduler(refusal))
    assert realtime.raise_priority(0) == "no: not asked for"
    said = realtime.raise_priority(7)
    assert said == "no: Operation not permitted; the service needs LimitRTPRIO=7"


def test_garbage_is_collected_once_and_never_looked_at_again() -> None:
    done = child(
        "import gc, weakref\n"
        "class Ring: pass\n"
        "gc.disable()\n"
        "ring = Ring(); ring.ring = ring; gone = weakref.ref(ring); del ring\n"
        "gc.enable()\n"
        "realtime.stop_garbage_collection()\n"
        "print(gone() is None, gc.isenabled(), gc.get_freeze_count() > 1000)"
    )
    assert done.stdout == "True False True\n"


def test_pages_that_are_used_stay_in_memory_and_others_out_of_it() -> None:
    """By what the kernel counts; where it refuses, there is nothing to count."""
    done = child(
        "import mmap\n"
        "def count(name):\n"
        " with open('/proc/self/status') as file:\n"
        "  return int(next(line for line in file if line.startswith(name)).split()[1])\n"
        "said = realtime.lock_memory()\n"
        "locked, resident = count('VmLck'), count('VmRSS')\n"
        "more = mmap.mmap(-1, 64 << 20)\n"
        "print(said, locked > 10000, count('VmLck') >= locked + 65536,\n"
        "      count('VmRSS') < resident + 32768, sep='|')"
    )
    said, *counted = done.stdout.strip().split("|")
    assert counted == ["True"] * 3 if said == "yes" else said.startswith("no: ")


class Libc:
    """Refuses to lock memory; errno is told to who asks for it, as by ctypes."""

    def __init__(self, name: str | None, *, use_errno: bool = False) -> None:
        self._use_errno = use_errno

    def mlockall(self, flags: int) -> int:
        ctypes.set_errno(errno.ENOMEM if self._use_errno else 0)
        return -1


def test_memory_that_cannot_be_locked_is_told_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ctypes, "CDLL", Libc)
    said = realtime.lock_memory()
    assert said == "no: Cannot allocate memory; the service needs LimitMEMLOCK=infinity"
