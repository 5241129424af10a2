"""Who closes a camera's shutter when the process that opened it is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.ptp import shutter as shutter_module
from drivers.ptp.shutter import PtpShutter
from drivers.virtual_camera import BULB_BODY, CameraBody, FaultScript, PlainFilm, VirtualUsb
from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.devices import DriverContext, SharedState
from pdcd.bench.tables import Config, TriggerConfig
from pdcd.errors import DeviceLost, ExposureError
from tests import remote_usb
from tests.places import ROOT
from tests.processes import ended, send_every_signal, soon
from tests.virtual_eos import raw_of

pytestmark = pytest.mark.whole


class CountedUsb(VirtualUsb):
    """Counts how often somebody reads from the camera."""

    reads = 0

    def bulk_read(self, *asked: Any) -> int:
        self.reads += 1
        return super().bulk_read(*asked)


class Bench:
    """A camera in this process, and one elsewhere that works its shutter."""

    def __init__(self, folder: Path) -> None:
        self.body = CameraBody(RealClock(), PlainFilm(raw_of), BULB_BODY, FaultScript())
        self.usb = CountedUsb(self.body)
        address = folder / "usb"
        self.lender = remote_usb.serve(self.usb, address)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.guarded_shutter", str(address)],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )

    def tell(self, word: str) -> str:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(f"{word}\n")
        return self.process.stdout.readline().strip()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def close(self) -> None:
        self.kill()
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()
        self.lender.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.close()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_killed_process_leaves_a_closed_shutter(bench: Bench, number: int) -> None:
    assert bench.tell("open") == "open"
    assert bench.body.shutter.is_open
    guardian = int(bench.tell("pid"))
    bench.process.send_signal(number)
    assert soon(lambda: not bench.body.shutter.is_open)
    assert ended(guardian)
    assert bench.body.shutter.opened == 1 and not bench.body.session_open


def test_a_guardian_survives_every_signal_but_the_last(bench: Bench) -> None:
    bench.tell("open")
    send_every_signal(int(bench.tell("pid")))
    bench.kill()
    assert soon(lambda: not bench.body.shutter.is_open)


def test_an_exposure_that_nobody_guards_is_ended() -> None:
    body = CameraBody(RealClock(), PlainFilm(raw_of), BULB_BODY, FaultScript())
    config = Config(trigger=TriggerConfig(driver="ptp"))
    shared = SharedState(usb_backend=VirtualUsb(body))
    shutter = PtpShutter.create(DriverContext(config, RealClock(), shared))
    shutter.connect()
    shutter.open()
    assert shutter._guard is not None and shutter._guard.pid is not None
    shutter._guard._command = ("/nonexistent",)
    os.kill(shutter._guard.pid, signal.SIGKILL)
    assert soon(lambda: not body.shutter.is_open)
    with pytest.raises(ExposureError, match="spoiled: cannot start the process that guards"):
        shutter.close()
    shutter.disconnect()


def test_a_camera_that_another_program_holds_is_waited_for(bench: Bench) -> None:
    bench.tell("open")
    bench.usb.held_by_other = True
    bench.kill()
    time.sleep(0.5)
    assert bench.body.shutter.is_open
    bench.usb.held_by_other = False
    assert soon(lambda: not bench.body.shutter.is_open)


@pytest.mark.long
@pytest.mark.parametrize("last", ["close", "disconnect"])
def test_a_closed_shutter_is_left_alone(bench: Bench, last: str) -> None:
    bench.tell("open")
    guardian = int(bench.tell("pid"))
    bench.tell(last)
    read = bench.usb.reads
    bench.kill()
    assert ended(guardian)
    assert bench.usb.reads == read and len(bench.body.shutter.exposures) == 1


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("/nonexistent",), "cannot start the process that guards the shutter"),
        ((sys.executable, "-c", "pass"), "guards the shutter does not start"),
    ],
)
def test_no_exposure_without_a_guardian(
    command: tuple[str, ...], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = CameraBody(VirtualClock(), PlainFilm(raw_of), BULB_BODY, FaultScript())
    config = Config(trigger=TriggerConfig(driver="ptp"))
    shared = SharedState(usb_backend=VirtualUsb(body))
    shutter = PtpShutter.create(DriverContext(config, VirtualClock(), shared))
    monkeypatch.setattr(shutter_module, "PTP_GUARDIAN", command)
    with pytest.raises(DeviceLost, match=words):
        shutter.connect()
    with pytest.raises(DeviceLost, match=words):
        shutter.open()
    shutter.disconnect()
    assert body.shutter.opened == 0
