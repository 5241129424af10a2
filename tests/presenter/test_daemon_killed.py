"""The real daemon before real windows: what is left when a process is killed mid-exposure.

The camera is the mock, the shutter a box on a terminal that opens on "1" and closes on "0".
"""

from __future__ import annotations

import fcntl
import os
import select
import signal
import subprocess
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from pdcd.bench.tables import RigConfig, TriggerConfig
from pdcd.client import Client
from pdcd.presenter.xgrab import RootGrabber
from pdcd.protocol.events import ENDS, JobCancelled, JobDone, JobFailed
from pdcd.protocol.request import CaptureRequest
from tests import x11_rig
from tests.processes import ended, soon
from tests.real_daemon import connect, daemon, last_event, wait_for_codes
from tests.soak.processes import of_role
from tests.xserver import QUARTER, XServer, run

pytestmark = pytest.mark.timeout(180)

PATIENCE_S = 60.0
LOOK_S = 0.002
"""Between two looks at the screen: others need the processor, too."""
NEXT = CaptureRequest(goal="indirect", codes=12, window="whole", white=False)


@dataclass(frozen=True)
class Box:
    """The far side of a serial port."""

    port: str
    near: int
    far: int

    def hears(self, words: bytes) -> None:
        """Wait until the next bytes have come; they must be these."""
        data = b""
        while len(data) < len(words) and select.select([self.near], [], [], PATIENCE_S)[0]:
            data += os.read(self.near, len(words) - len(data))
        assert data == words

    def freed(self) -> None:
        """Let the port be opened anew, as its last close does: this test holds it open too."""
        fcntl.ioctl(self.far, termios.TIOCNXCL)

    @property
    def trigger(self) -> TriggerConfig:
        """The shutter that it holds."""
        options = {"port": self.port, "release": "command", "open_hex": "31", "close_hex": "30"}
        return TriggerConfig(driver="serial", lag_s=0.001, jitter_s=0.0, options=options)


@pytest.fixture
def box() -> Iterator[Box]:
    near, far = os.openpty()
    yield Box(os.ttyname(far), near, far)
    for end in (near, far):
        os.close(end)


@contextmanager
def served(
    folder: Path, server: XServer, trigger: TriggerConfig
) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A daemon whose panels are windows of a server: its process and its socket."""
    folder.mkdir(exist_ok=True)
    windows = x11_rig.config(folder, server)
    tables = {name: getattr(windows, name) for name in ("projector", "mask", "display")}
    rig = RigConfig(clock="real", on_miss="flag", settle_s=0.03)
    with daemon(folder, rig=rig, trigger=trigger, **tables) as both:
        yield both


def lit_after(kill: Callable[[], None], server: XServer) -> float:
    """For how many seconds after a kill any pixel of the X screen was still lit."""
    grabber = RootGrabber(server.display)
    try:
        assert soon(lambda: bool(grabber.grab().any())), "no code is on the panels"
        killed_s = last_s = time.monotonic()
        kill()
        while time.monotonic() - killed_s < x11_rig.WATCHED_S:
            if grabber.grab().any():
                last_s = time.monotonic()
            time.sleep(LOOK_S)
        return last_s - killed_s
    finally:
        grabber.close()


def end_of(client: Client, job: str) -> JobDone | JobFailed | JobCancelled:
    """The last event of a job."""
    return next(e for e in client.events() if isinstance(e, ENDS) and e.job == job)


@pytest.mark.long
def test_a_killed_daemon_leaves_black_panels_and_a_closed_shutter(
    tmp_path: Path, x_quarter: XServer, box: Box
) -> None:
    lit_s: list[float] = []
    while x11_rig.again(lit_s):
        box.freed()
        with (
            served(tmp_path / str(len(lit_s)), x_quarter, box.trigger) as (process, socket),
            connect(socket) as client,
        ):
            wait_for_codes(client)
            (presenter,) = of_role(process.pid, "presenter")
            box.hears(b"01")  # closed by the start, opened by the exposure
            lit_s.append(lit_after(process.kill, x_quarter))
            box.hears(b"0")
            assert ended(presenter)
            assert not x11_rig.root_pixels(x_quarter).any()
    x11_rig.assert_dark_in_time(lit_s)


@pytest.mark.whole
def test_a_killed_presenter_leaves_black_panels_a_closed_shutter_and_a_daemon(
    tmp_path: Path, x_quarter: XServer, box: Box
) -> None:
    lit_s: list[float] = []
    with served(tmp_path, x_quarter, box.trigger) as (process, socket), connect(socket) as client:
        box.hears(b"0")
        while x11_rig.again(lit_s):
            job = wait_for_codes(client)
            box.hears(b"1")
            (presenter,) = of_role(process.pid, "presenter")
            lit_s.append(lit_after(lambda: os.kill(presenter, signal.SIGKILL), x_quarter))  # noqa: B023
            last = end_of(client, job)
            assert isinstance(last, JobFailed) and last.error is not None
            assert last.error["kind"] == "device_lost"
            box.hears(b"0")
            assert not x11_rig.root_pixels(x_quarter).any()
        assert process.poll() is None and client.status().state == "idle"
    x11_rig.assert_dark_in_time(lit_s)


@pytest.mark.long
def test_the_next_capture_after_a_killed_presenter_works(
    tmp_path: Path, x_quarter: XServer
) -> None:
    """With the mock shutter, without which the mock camera knows of no exposure."""
    trigger = TriggerConfig()
    with served(tmp_path, x_quarter, trigger) as (process, socket), connect(socket) as client:
        job = wait_for_codes(client)
        (presenter,) = of_role(process.pid, "presenter")
        os.kill(presenter, signal.SIGKILL)
        assert isinstance(end_of(client, job), JobFailed)
        result = client.capture(NEXT)
        assert result.state == "done", result.error
        assert process.poll() is None


@pytest.mark.long
def test_a_killed_x_server_fails_the_job_and_the_daemon_goes_on(tmp_path: Path, box: Box) -> None:
    with (
        run(*QUARTER) as server,
        served(tmp_path, server, box.trigger) as (process, socket),
        connect(socket) as client,
    ):
        job = wait_for_codes(client)
        box.hears(b"01")
        os.kill(server.pid, signal.SIGKILL)
        last = end_of(client, job)
        assert isinstance(last, JobFailed) and last.error is not None
        assert last.error["kind"] == "device_lost"
        box.hears(b"0")
        assert last_event(tmp_path, job)["safe"] is False  # nobody can say what the panels show
        again = client.capture(NEXT)  # still no server to show it
        assert again.state == "failed"
        assert again.error is not None and again.error["kind"] == "device_lost"
        assert process.poll() is None and client.status().state == "idle"
