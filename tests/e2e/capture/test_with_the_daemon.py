"""The daemon and its work process: who outlives whom, and who is heard meanwhile."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from pdcd.errors import PlanError
from pdcd.protocol.request import CaptureRequest
from tests.processes import LONG_S
from tests.real_daemon import connect, daemon
from tests.soak.processes import gone, of_role

REQUEST = CaptureRequest(goal="indirect", codes=8, white=False)


@pytest.mark.long
def test_a_killed_daemon_takes_its_work_process_along_even_a_frozen_one(tmp_path: Path) -> None:
    with daemon(tmp_path) as (process, path), connect(path) as client:
        assert client.plan(REQUEST).codes == 8
        (pid,) = of_role(process.pid, "decoder")
        os.kill(pid, signal.SIGSTOP)  # so that it cannot look at its socket
        process.kill()
        assert not gone({pid}, LONG_S)  # by design it ends at once


@pytest.mark.long
def test_the_loop_goes_on_beside_a_plan_that_does_not_and_only_the_daemon_ends_its_child(
    tmp_path: Path,
) -> None:
    with daemon(tmp_path) as (process, path), connect(path) as client, connect(path) as other:
        assert client.plan(REQUEST).codes == 8
        (pid,) = of_role(process.pid, "decoder")
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            os.kill(pid, number)  # as systemd and a terminal send it to the whole group
        assert client.plan(REQUEST).codes == 8
        assert of_role(process.pid, "decoder") == [pid]
        os.kill(pid, signal.SIGSTOP)
        asked = client._send("capture.plan", {"goal": "indirect", "codes": 8})
        assert other.status().state == "busy"
        time.sleep(1.0)  # nothing shows when the child was asked; before that, another one is
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(PlanError, match="signal 9"):
            client._answer(asked, 60.0, None)
        assert client.plan(REQUEST).codes == 8
        (pid,) = of_role(process.pid, "decoder")
        process.terminate()
        assert process.wait(60.0) == 0
        assert not gone({pid}, 0.0)
