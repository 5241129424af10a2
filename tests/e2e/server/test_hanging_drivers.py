"""A driver that never returns keeps no daemon: panels black, shutter closed, and it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pdcd.client import Client
from pdcd.protocol.request import CaptureRequest
from pdcd.server.ending import KEPT_S, ORDERLY_S, SAFE_S
from tests.places import ROOT
from tests.processes import LONG_S, soon
from tests.real_daemon import connect

pytestmark = pytest.mark.whole

DATA = ROOT / "tests" / "data"

CONFIG = """
[rig]
clock = "{clock}"

[projector]
size_px = [32, 24]

[mask]
size_px = [32, 24]

[display]
driver = "hanging"

[trigger]
{trigger}

[camera]
driver = "hanging"
profile = "{profile}"
f_number = 16.0

[schedule]
grid = [6, 8]
codes = 64

[server]
state_dir = "{folder}/state"

[limits]
min_free_bytes = 0
"""

HANGING = 'driver = "hanging"'

SERVE = (
    "import sys; from pdcd.server import ending; from pdcd.cli.main import main;"
    "ending.ORDERLY_S, ending.SAFE_S, ending.KEPT_S = {}; sys.exit(main(sys.argv[1:]))"
)
"""`pdcd serve` with times of its own for its end."""
QUICK = (1.0, 1.0, 3.0)


class Daemon:
    """A daemon whose drivers tell a file what they do, and hang in one call."""

    def __init__(
        self, folder: Path, call: str, how: str, trigger: str = HANGING, clock: str = "virtual"
    ) -> None:
        self.folder, self.notes, self.socket = folder, folder / "notes", folder / "s"
        profile = DATA / "stranger_driver" / "stranger_bench" / "sensor.toml"
        self.config = folder / "bench.toml"
        tables = {"trigger": trigger, "profile": profile, "folder": folder, "clock": clock}
        self.config.write_text(CONFIG.format(**tables))
        paths = (ROOT, DATA / "stranger_driver", DATA / "stranger_hangs")
        self.environ = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, paths)),
            "STRANGER_HANGS": f"{call} {how} {self.notes}",
        }
        self.call = call

    @contextmanager
    def running(self, times: tuple[float, ...] = QUICK) -> Iterator[subprocess.Popen[str]]:
        words = ("serve", "--config", str(self.config), "--socket", str(self.socket))
        command = (sys.executable, "-c", SERVE.format(times), *words)
        with subprocess.Popen(
            command, cwd=ROOT, env=self.environ, text=True, stderr=subprocess.PIPE
        ) as process:
            try:
                yield process
            finally:
                process.kill()

    def told(self) -> list[str]:
        return self.notes.read_text().splitlines() if self.notes.exists() else []

    def until_it_hangs(self) -> None:
        """Take a photo, where the daemon gets that far."""
        if self.call.endswith(".connect"):
            assert soon(lambda: self.call in self.told())
        else:
            client: Client
            with connect(self.socket) as client:
                client.capture(CaptureRequest(goal="white"), detach=True)
                if self.call.endswith(".disconnect"):
                    return
                assert soon(lambda: self.call in self.told())

    def is_safe(self) -> bool:
        """Whether black came after the last light, and the blades closed after they opened."""
        told = ["display.black", "shutter.close", *self.told()]

        def last(*calls: str) -> str:
            return [call for call in told if call in calls][-1]

        lit = last("display.black", "display.play")
        return (lit, last("shutter.open", "shutter.close")) == ("display.black", "shutter.close")


@pytest.mark.parametrize(
    ("call", "how"),
    [
        ("display.connect", "sleep"),
        ("shutter.connect", "sleep"),
        ("readout.connect", "loop"),
        ("readout.arm", "sleep"),
        ("shutter.open", "sleep"),
        ("display.play", "loop"),
        ("readout.fetch", "sleep"),
        ("readout.disconnect", "sleep"),
    ],
)
def test_a_call_that_never_returns_is_left_behind(call: str, how: str, tmp_path: Path) -> None:
    daemon = Daemon(tmp_path, call, how)
    with daemon.running() as process:
        daemon.until_it_hangs()
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=LONG_S)
        assert process.returncode == 5, err
    assert "left in begin at" in err
    assert call in daemon.told() and daemon.is_safe()


@pytest.mark.parametrize("call", ["readout.connect", "readout.fetch"])
def test_a_driver_that_waits_with_patience_hears_the_end(call: str, tmp_path: Path) -> None:
    daemon = Daemon(tmp_path, call, "patient")
    with daemon.running() as process:
        daemon.until_it_hangs()
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=LONG_S)
        assert process.returncode == 0, err
    assert daemon.is_safe() and "display.disconnect" in daemon.told()
    assert not daemon.socket.exists()


def test_a_driver_that_waits_with_patience_hears_a_cancel(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path, "readout.fetch", "patient")
    with daemon.running(), connect(daemon.socket) as client:
        job = client.capture(CaptureRequest(goal="white"), detach=True).job
        assert soon(lambda: daemon.call in daemon.told())
        client.call("capture.cancel", {"job": job})
        assert daemon.is_safe() and client.status().state == "idle"


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """Both ends of a pseudo-terminal."""
    ends = os.openpty()
    yield ends
    for end in ends:
        os.close(end)


@pytest.mark.parametrize("call", ["readout.arm", "display.play", "readout.fetch"])
def test_a_call_that_holds_the_interpreter_is_ended_from_outside(
    call: str, tmp_path: Path, terminal: tuple[int, int]
) -> None:
    """Only a shutter with a guardian can be closed then, as one on a serial line has it."""
    near, far = terminal
    box = (
        'driver = "serial"\n[trigger.options]\nrelease = "command"\n'
        f'port = "{os.ttyname(far)}"\nopen_hex = "31"\nclose_hex = "30"'
    )
    daemon = Daemon(tmp_path, call, "held", box, "real")
    with daemon.running() as process:
        daemon.until_it_hangs()
        process.send_signal(signal.SIGTERM)
        assert process.wait(LONG_S) == -signal.SIGKILL
    heard = b""
    os.set_blocking(near, False)

    def closed() -> bool:
        nonlocal heard
        try:
            heard += os.read(near, 1 << 16)
        except BlockingIOError:
            return heard.endswith(b"0")
        return False

    assert soon(closed) and (b"1" in heard) == (call != "readout.arm")


def test_all_ways_of_ending_take_less_than_ten_seconds() -> None:
    assert ORDERLY_S + 2 * SAFE_S < 10.0 and ORDERLY_S + SAFE_S < KEPT_S < 10.0


@pytest.mark.long
def test_it_ends_in_the_time_that_it_has(tmp_path: Path) -> None:
    """In its own times, on a machine that may be busy with other tests."""
    daemon = Daemon(tmp_path, "readout.fetch", "sleep")
    with daemon.running((ORDERLY_S, SAFE_S, KEPT_S)) as process:
        daemon.until_it_hangs()
        begun_s = time.monotonic()
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=LONG_S)
        assert ORDERLY_S <= time.monotonic() - begun_s < LONG_S
    assert daemon.is_safe()
