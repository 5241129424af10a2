"""The real daemon with the real engine, in real time: signals and lost clients mid-exposure."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pdcd.bench import config as settings
from pdcd.bench.tables import CameraConfig, RigConfig
from pdcd.client import Client
from pdcd.protocol.entry import RunQuery
from pdcd.protocol.events import Progress
from pdcd.protocol.line_talk import UnreachableError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import Quality
from pdcd.runs.folder import read_manifest
from tests import bench_rig

pytestmark = pytest.mark.whole

GUARD_S = 60.0
"""What would hang otherwise; a free machine takes less than a second for it."""


@contextmanager
def daemon(folder: Path, **tables: Any) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    path = folder / "pdcd.toml"
    given = {"camera": CameraConfig(noise="none", f_number=8.0), **tables}
    path.write_text(settings.format_config(bench_rig.config(folder, **given)))
    socket = folder / "s"
    command = [
        sys.executable,
        "-m",
        "pdcd",
        "serve",
        "--config",
        str(path),
        "--socket",
        str(socket),
    ]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            yield process, socket
        finally:
            process.kill()


def connect(socket: Path) -> Client:
    give_up = time.monotonic() + GUARD_S
    while True:
        try:
            return Client(socket)
        except UnreachableError:
            assert time.monotonic() < give_up
            time.sleep(0.02)


def wait_for_codes(client: Client) -> str:
    """Start one long exposure, without a pilot's short ones in front of it, and return its job once
    codes are being shown."""
    params = {"goal": "indirect", "codes": 512, "white": False, "pilot": 0, "parts": 1}
    job = str(client.call("capture.start", params)["job"])
    client.call("events.subscribe", {"jobs": "all"})
    for event in client.events():
        if isinstance(event, Progress) and event.frame > 0:
            return job
    raise AssertionError("no progress")


def last_event(folder: Path, job: str) -> dict[str, Any]:
    log = folder / "state" / "captures" / f"{job}.partial" / "log.jsonl"
    give_up = time.monotonic() + GUARD_S
    while True:
        lines = log.read_text().splitlines() if log.exists() else []
        events: list[dict[str, Any]] = [json.loads(line) for line in lines]
        if events and events[-1]["event"] in ("cancelled", "failed"):
            return events[-1]
        assert time.monotonic() < give_up
        time.sleep(0.02)


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_signal_mid_exposure_ends_black_and_closed(tmp_path: Path, number: signal.Signals) -> None:
    with daemon(tmp_path, rig=RigConfig(clock="real")) as (process, socket):
        with connect(socket) as client:
            job = wait_for_codes(client)
            process.send_signal(number)
            assert process.wait(timeout=GUARD_S) == 0
        event = last_event(tmp_path, job)
        assert event["event"] == "cancelled" and event["safe"] is True
        assert not list(tmp_path.rglob("capture.json"))
        assert not socket.exists()


def test_client_gone_mid_exposure_cancels_its_job(tmp_path: Path) -> None:
    with daemon(tmp_path, rig=RigConfig(clock="real")) as (_, socket):
        with connect(socket) as client:
            job = wait_for_codes(client)
        event = last_event(tmp_path, job)
        assert event["event"] == "cancelled" and event["safe"] is True
        with connect(socket) as client:
            give_up = time.monotonic() + GUARD_S
            while client.status().state != "idle":  # the log is written just before
                assert time.monotonic() < give_up


def test_a_capture_over_the_socket_and_the_folder_it_names(tmp_path: Path) -> None:
    with daemon(tmp_path) as (process, socket):
        events: list[str] = []
        with connect(socket) as client:
            result = client.capture(
                CaptureRequest(goal="indirect", codes=64, name="a book", tags=("v",), note="n"),
                on_event=lambda e: events.append(e.type),
            )
            (found,) = client.find(RunQuery(tags=("v",))).runs
        assert result.state == "done" and result.folder is not None
        assert read_manifest(Path(result.folder)).job == result.job
        assert (found.job, found.folder, found.state) == (result.job, result.folder, "done")
        assert (found.name, found.tags, found.note) == ("a book", ("v",), "n")
        for figure in ("codes", "exposure_s", "rms_error_quads", "rms_sigma", "method"):
            assert getattr(found, figure) == result.summary[figure] is not None
        quality = result.summary["quality"]
        assert isinstance(quality, Quality) and found.verdict == quality.verdict
        wanted = [
            "queued",
            "armed",
            "shutter_open",
            "progress",
            "shutter_closed",
            "decoding",
            "done",
        ]
        assert [e for e in dict.fromkeys(events) if e in wanted] == wanted
        process.terminate()
        assert process.wait(timeout=GUARD_S) == 0
