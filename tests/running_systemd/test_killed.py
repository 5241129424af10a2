"""What systemd does to a daemon in an exposure, as seen from the shutter's end of the line."""

from __future__ import annotations

import pytest

from tests.running_systemd.machine import Machine, wait_until
from tests.running_systemd.service import CAPTURE_TOML, Line, Service

CLOSED_S = 1.0
"""Within this time of a kill the shutter has to be told to close."""

HANGING = """
import threading
from drivers.mock import MockDisplay

class HangingDisplay(MockDisplay):
    '''Shows its first code for ever, whoever asks it to stop.'''

    def play(self, progress, cancelled):
        progress(1, 10, 0)
        threading.Event().wait()
"""
ENTRY_POINTS = "[pdcd.drivers]\ndisplay.hanging = hanging_bench:HangingDisplay\n"


@pytest.fixture
def exposing(service: Service, line: Line) -> Service:
    """A service whose shutter is on the line."""
    service.configure(CAPTURE_TOML + line.toml)
    return service


def test_a_frozen_daemon_leaves_a_closed_shutter_and_the_watchdog_brings_the_service_back(
    exposing: Service, line: Line
) -> None:
    """With the watchdog's time as shipped, which is longer than that of a guardian."""
    machine = exposing.machine
    with exposing.connect() as client:
        exposing.in_exposure(client)
        line.hears("01")  # closed by the start, opened by the exposure
        first = machine.main_pid()
        machine.run("kill", "-STOP", first)
        closed_s = line.hears("0")
    assert closed_s < exposing.said_at_s("Watchdog timeout")
    line.hears("0")  # by the start of the next one
    wait_until(lambda: machine.main_pid() not in ("0", first), "a new daemon")
    with exposing.connect() as client:
        assert client.status().state == "idle"
    assert machine.shows("NRestarts") == "1"


@pytest.mark.parametrize("signal", ["ABRT", "QUIT", "SEGV", "USR1", "KILL"])
def test_a_killed_daemon_leaves_a_closed_shutter(
    exposing: Service, line: Line, signal: str
) -> None:
    """All of the service gets the signal; SIGKILL, which nothing survives, the daemon alone."""
    machine = exposing.machine
    with exposing.connect() as client:
        exposing.in_exposure(client)
        line.hears("01")
        whom = "main" if signal == "KILL" else "all"
        machine.systemctl("kill", f"--signal={signal}", f"--kill-whom={whom}", "pdcd.service")
        closed_s = line.hears("0")
    assert -0.1 < closed_s - exposing.said_at_s("Main process exited") < CLOSED_S


def test_a_daemon_that_does_not_end_is_killed_and_its_guardian_is_not(
    exposing: Service, line: Line
) -> None:
    machine = exposing.machine
    _install_hanging_driver(machine)
    exposing.configure(CAPTURE_TOML + '[display]\ndriver = "hanging"\n' + line.toml)
    exposing.drop_in("TimeoutStopSec=3")
    with exposing.connect() as client:
        exposing.in_exposure(client)
        line.hears("01")
        machine.systemctl("stop", "pdcd.service")
        closed_s = line.hears("0")
    assert -0.1 < closed_s - exposing.said_at_s("timed out. Killing") < CLOSED_S
    assert machine.shows("Result") == "timeout"
    assert not exposing.guardians()


@pytest.mark.parametrize("signal", ["KILL", "STOP"])
def test_a_guardian_that_is_lost_is_replaced(exposing: Service, line: Line, signal: str) -> None:
    """The sandbox lets the daemon start another in the middle of an exposure."""
    machine = exposing.machine
    with exposing.connect() as client:
        exposing.in_exposure(client)
        line.hears("01")
        (first,) = exposing.guardians()
        machine.run("kill", f"-{signal}", str(first))
        wait_until(
            lambda: bool(exposing.guardians()) and first not in exposing.guardians(), "another"
        )
        machine.run("kill", "-KILL", machine.main_pid())
        line.hears("0")


def test_what_runs_out_of_memory_does_not_take_the_daemon_along(
    exposing: Service, line: Line
) -> None:
    """A process of the service that takes all it can get, in the middle of an exposure."""
    machine = exposing.machine
    exposing.drop_in("MemoryMax=500M")
    with exposing.connect() as client:
        job = exposing.in_exposure(client)
        line.hears("01")
        daemon = machine.main_pid()
        if machine.shows("MemoryCurrent") == "[not set]":
            pytest.skip("no memory controller for systemd on this machine")
        greedy = _run_in_group_of(machine, daemon, "kept = [b'x' * (1 << 24) for _ in range(99)]")
        assert greedy == -9
        assert machine.main_pid() == daemon
        assert client.status().state == "busy"
        client.call("capture.cancel", {"job": job})
        line.hears("0")
    with exposing.connect() as client:
        assert client.status().state == "idle"


def _install_hanging_driver(machine: Machine) -> None:
    extra = "/opt/pdcd/extra"
    machine.write(f"{extra}/hanging_bench.py", HANGING)
    info = f"{extra}/hanging_bench-1.dist-info"
    machine.write(f"{info}/METADATA", "Metadata-Version: 2.1\nName: hanging-bench\nVersion: 1\n")
    machine.write(f"{info}/entry_points.txt", ENTRY_POINTS)


def _run_in_group_of(machine: Machine, pid: str, program: str) -> int:
    """Run a Python program as if that process had started it; its exit status, -9 for SIGKILL."""
    groups = machine.run("cat", f"/proc/{pid}/cgroup").stdout.splitlines()
    paths = {line.split(":")[1]: line.split(":")[2] for line in groups}
    folder = f"memory{paths['memory']}" if "memory" in paths else paths[""]
    enter = (
        f"set -e; echo $$ >/sys/fs/cgroup/{folder}/cgroup.procs; echo 500 >/proc/self/oom_score_adj"
    )
    words = ("sh", "-c", f'{enter}; exec python -c "$1"', "sh", program)
    status = machine.run(*words, check=False).returncode
    return status if status < 128 else 128 - status
