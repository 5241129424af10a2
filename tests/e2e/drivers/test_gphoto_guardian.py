"""Who ends a bulb exposure over the real libgphoto2 when the process that began it is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import pytest

pytest.importorskip("gphoto2", reason="gphoto2 IS MISSING: see .venv/gphoto2.log")

from tests.places import ROOT
from tests.processes import LONG_S, ended

HOLDER = """
import sys, time
from drivers.gphoto.camera import GphotoShutter
from pdcd.bench.clock import RealClock
from pdcd.driver import CameraConfig, Config, DriverContext, TriggerConfig
from pdcd.bench.tables import RigConfig

options = {"port": sys.argv[1], "model": "PTP/IP Camera"}
config = Config(
    rig=RigConfig(clock="real"),
    camera=CameraConfig(driver="gphoto2", options=options),
    trigger=TriggerConfig(driver="gphoto2"),
)
shutter = GphotoShutter.create(DriverContext(config, RealClock()))
shutter.connect()
shutter.open()
print(shutter._guard.pid, flush=True)
time.sleep(3600.0)
"""


def start(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, *words],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("guarded", [True, False])
def test_a_killed_process_leaves_a_closed_shutter(guarded: bool) -> None:
    """And without its guardian an open one, so that it is the guardian who closed it."""
    with start("-m", "tests.virtual_eos_server") as camera:
        assert camera.stdout is not None
        port = camera.stdout.readline().strip()
        with start("-c", HOLDER, f"ptpip:127.0.0.1:{port}:{port}") as holder:
            assert holder.stdout is not None
            guardian = int(holder.stdout.readline())
            if not guarded:
                os.kill(guardian, signal.SIGSTOP)
                holder.send_signal(signal.SIGSTOP)  # or it would have another
                os.kill(guardian, signal.SIGKILL)
            holder.kill()
        assert ended(guardian)
        told, _ = camera.communicate(timeout=LONG_S)
    assert len(json.loads(told)["seconds"]) == guarded
