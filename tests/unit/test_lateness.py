"""The measure of a late machine: a keeper of time that was held up says so, and for how long."""

from __future__ import annotations

import os
import signal
import time

import pytest

from tests.lateness import LATE_S, Machine, watched


def test_a_keeper_that_was_stopped_tells_of_a_late_machine() -> None:
    with watched() as machine:
        os.kill(machine.pid, signal.SIGSTOP)
        time.sleep(0.05)
        os.kill(machine.pid, signal.SIGCONT)
    assert machine.worst_s > 0.04
    with pytest.raises(pytest.skip.Exception, match="THE MACHINE IS LATE"):
        machine.quiet_or_skip("it spoilt a pass")
    Machine(0, worst_s=LATE_S).quiet_or_skip("one in time is no excuse")
